"""One replay in a fresh process: `python -m fbench.api.verify_child`, the task as JSON.

Where the task can't be done, the last line of stdout is the error. The exit code is that of `fbench replay`. Threads
are those of the environment, not those that `fbench` sets.
"""

import json
import locale
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from fbench.api.replays import make_plan, open_requested
from fbench.api.scores import IN_LOCKSTEP, score_folder
from fbench.api.suites.cells import own_stdout
from fbench.replay.check.difference import TASK, WATCH, VerifyTask, WatchedPipeline, WatchedReader, convert_to
from fbench.replay.contracts.errors import EXIT_OK, FbenchError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.plugins import give_log
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.engine.clock import make_clock
from fbench.replay.engine.loop import replay
from fbench.replay.engine.read_ahead import open_ahead
from fbench.replay.logs.open import open_container
from fbench.replay.setup.source import LogSource


def main() -> int:
    """Do what stdin says."""
    with own_stdout() as out:
        try:
            run(TASK.validate_python(json.loads(sys.stdin.buffer.read())))
        except FbenchError as error:
            out.write(f"{error.line}\n")
            return error.exit_code
    return EXIT_OK


def run(task: VerifyTask) -> None:
    """Replay, score, and note what the frames were made of."""
    import cv2

    cv2.setNumThreads(task.num_threads)
    with suppress(locale.Error):  # a locale that this machine doesn't have changes nothing
        locale.setlocale(locale.LC_ALL, "")
    request, options, faults = task.request, task.request.resolve(), FaultLog()
    with (
        open_requested(request, options.settings) as (pipeline, parameters),
        _open_source(task, options.log) as log,
        open_ahead(log.open, faults, options.read_ahead) as ahead,
    ):
        give_log(pipeline, request.pipeline, lambda: log.open(faults))
        reader = WatchedReader(ahead)
        watched = WatchedPipeline(pipeline, reader)
        clock = make_clock(request.rate, options.sync.max_gap_ns)
        plan = replace(
            make_plan(options, watched, "verified", parameters), clock=clock, latency=options.latency, num_media=0
        )

        def complete(folder: Path) -> None:
            (folder / WATCH).write_text(json.dumps(watched.rows), encoding="utf-8")
            if request.latency is not None:
                lockstep = replace(request, latency=None, overload=None)
                run(replace(task, request=lockstep, folder=folder / IN_LOCKSTEP))
            score_folder(folder, ScoreOptions())

        replay(reader, plan, task.folder, faults, complete=complete)


@contextmanager
def _open_source(task: VerifyTask, source: LogSource) -> Iterator[LogSource]:
    """Give the log, converted if that is wanted; the converted one is removed at the end."""
    if task.form is None:
        yield source
        return
    beside = task.folder.with_name(f"{task.folder.name}.log")
    beside.mkdir(parents=True)
    try:
        yield replace(source, path=convert_to(task.form, open_container(source.path, FaultLog()), beside))
    finally:
        shutil.rmtree(beside, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
