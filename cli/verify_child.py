"""One replay in a fresh process: `python -m fbench.cli.verify_child`, the task as JSON.

Where the task can't be done, the last line of stdout is the error. The exit code is that of `fbench replay`. Threads
are those of the environment, not those that `fbench` sets.
"""

import json
import locale
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fbench.cli.responses import answers
from fbench.cli.scoring import score_folder
from fbench.replay.check.verify_task import WATCH, Task
from fbench.replay.check.watch import WatchedPipeline, WatchedReader, converted
from fbench.replay.contracts.errors import EXIT_OK, FbenchError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.plugins import give_log, opened_pipeline
from fbench.replay.contracts.variants import sensors_of
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.engine.clock import make_clock
from fbench.replay.engine.loop import Plan, replay
from fbench.replay.engine.read_ahead import opened_ahead
from fbench.replay.logs.open import open_container
from fbench.replay.setup.source import LogSource, log_source


def main() -> int:
    """Do what stdin says."""
    with answers() as out:
        try:
            run(Task.from_json(sys.stdin.buffer.read().decode()))
        except FbenchError as error:
            out.write(f"{error}\n")
            return error.exit_code
    return EXIT_OK


def run(task: Task) -> None:
    """Replay, score, and note what the frames were made of."""
    _prepare(task.num_threads)
    faults = FaultLog()
    with (
        opened_pipeline(task.pipeline, task.settings) as (pipeline, parameters),
        _log(task) as log,
        opened_ahead(log.open, faults, task.read_ahead) as ahead,
    ):
        give_log(pipeline, task.pipeline, lambda: log.open(faults))
        reader = WatchedReader(ahead)
        watched = WatchedPipeline(pipeline, reader)
        plan = Plan(
            watched,
            "verified",
            parameters,
            sync=task.sync,
            stamps=task.stamps,
            excerpt=task.excerpt,
            topics=log.topics,
            sensors=sensors_of(task.pipeline, task.sensors),
            inputs=log.used(),
            truth=log.truth_entry(),
            clock=make_clock(task.rate, task.sync.max_gap_ns),
            num_media=0,
        )
        replay(reader, plan, task.folder, faults, complete=lambda folder: _complete(folder, watched))


def _complete(folder: Path, watched: WatchedPipeline) -> None:
    (folder / WATCH).write_text(json.dumps(watched.rows), encoding="utf-8")
    score_folder(folder, ScoreOptions())


def _prepare(num_threads: int) -> None:
    import cv2

    cv2.setNumThreads(num_threads)
    with suppress(locale.Error):  # a locale that this machine doesn't have changes nothing
        locale.setlocale(locale.LC_ALL, "")


@contextmanager
def _log(task: Task) -> Iterator[LogSource]:
    """Give the log, converted if that is wanted; the converted one is removed at the end."""
    source = log_source(task.log)
    if task.form is None:
        yield source
        return
    beside = task.folder.with_name(f"{task.folder.name}.log")
    beside.mkdir(parents=True)
    try:
        yield source.at(converted(open_container(source.path, FaultLog()), beside, task.form))
    finally:
        shutil.rmtree(beside, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
