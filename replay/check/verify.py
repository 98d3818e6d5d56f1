"""Verification: one task replayed under many circumstances, each in a fresh process, and compared."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

from fbench.replay.check.difference import TASK, Difference, Form, Outcome, VerifyTask, first_difference
from fbench.replay.contracts.errors import EXIT_USAGE, ConfigError, FbenchError, LogError, output_error
from fbench.replay.contracts.plugins import parse_name, with_absolute_files
from fbench.replay.contracts.variants import SUFFIX
from fbench.replay.geometry.threads import VARIABLE
from fbench.replay.setup.request import ReplayRequest

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", VARIABLE)
PACED_S = 2.0  # Wall time that a paced replay waits for log time


@dataclass(frozen=True)
class Variant:
    """One way to replay."""

    name: str
    rate: str = "max"
    read_ahead: str = "auto"
    form: Form | None = None
    num_threads: int = 1
    hash_seed: str = "0"
    environment: Mapping[str, str] = field(default_factory=dict)
    elsewhere: bool = False  # In another working directory


BASE = Variant("reference")


def variants(num_repeats: int, span_s: float, quick: bool) -> tuple[Variant, ...]:
    """All circumstances to try, or only those that find most: `quick` leaves out rates, reading ahead and containers.
    The same is replayed `num_repeats` times, the reference included; the log is `span_s` long, without pauses.
    """
    repeats = tuple(Variant(f"repeat {i}" if num_repeats > 2 else "repeat") for i in range(1, num_repeats))
    few = (*repeats, Variant("hash seed 1", hash_seed="1"), Variant("2 threads", num_threads=2))
    if quick:
        return few
    paced = f"{span_s / PACED_S:.4g}" if span_s else "1"
    abroad = {"TZ": "Asia/Kathmandu", "LC_ALL": "tr_TR.UTF-8"}
    return (
        *few,
        Variant("random hash seed", hash_seed="random"),
        Variant(f"rate {paced}", rate=paced),
        Variant("no read-ahead", read_ahead="0"),
        Variant("read-ahead of all", read_ahead="all"),
        Variant("other time zone, locale and folder", environment=abroad, elsewhere=True),
        Variant("MCAP unchunked", form="unchunked"),
        Variant("MCAP lz4", form="lz4"),
        Variant("MCAP in small chunks", form="small chunks"),
        Variant("Parquet", form="parquet"),
    )


_AT_ONCE = 2


@dataclass(frozen=True)
class Verified:
    """All that was found."""

    digests: Mapping[str, str]  # Of the reference, by stage
    differences: Mapping[str, Difference | None]  # By variant; `None` where it gave the same bits as the reference

    @property
    def identical(self) -> bool:
        """Whether all gave the same bits."""
        return not any(self.differences.values())


def verify_in(
    request: ReplayRequest,
    num_repeats: int,
    quick: bool,
    folder: Path,
    worker: str,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> Verified:
    """Replay under all circumstances, or only (`quick`) those that find most; runs go into folders within `folder`,
    which is empty. The request's pace, reading ahead and run folder don't matter. The same is replayed `num_repeats`
    times, the reference included; `worker` is the module that replays one `VerifyTask`, given as JSON on stdin;
    `progress` gets the numbers of finished and of all replays. Raises ConfigError or LogError where the reference
    itself can't be replayed.
    """
    settings = []
    for setting in request.settings:  # each `NAME=FILE`, or `NAME=COMMAND` with files in it
        name, equals, value = setting.partition("=")
        settings.append(f"{name}{equals}{with_absolute_files(value)}")
    moved = replace(request.absolute(), pipeline=_make_absolute(request.pipeline), settings=settings)
    children = _Children(moved, folder.resolve(), worker)
    with ThreadPoolExecutor(_AT_ONCE) as pool, ExitStack() as ends:
        # Where this ends early, none of those begins that wait in the pool, and none goes on.
        ends.callback(children.kill)
        ends.callback(pool.shutdown, wait=False, cancel_futures=True)
        failed = children.replay(BASE)
        if failed is not None:
            raise failed
        base = Outcome(children.folder(BASE))
        # How long the run is in log time, without pauses between segments.
        steps_ns = (b.stamp_ns - a.stamp_ns for a, b in pairwise(base.run.frames) if a.segment == b.segment)
        others = variants(num_repeats, sum(steps_ns) / 1e9, quick)
        if request.latency is not None:  # then the rate decides what is dropped
            others = tuple(variant for variant in others if variant.rate == BASE.rate)
        progress(1, len(others) + 1)
        futures = {variant.name: pool.submit(children.compare, variant, base) for variant in others}
        for num, _ in enumerate(as_completed(futures.values()), 2):
            progress(num, len(others) + 1)
        return Verified(base.digests, {name: future.result() for name, future in futures.items()})


class _Children:
    def __init__(self, request: ReplayRequest, folder: Path, worker: str) -> None:
        self._request, self._folder, self._worker = request, folder, worker
        self._running: list[subprocess.Popen[str]] = []
        self._elsewhere = folder / "elsewhere"
        self._elsewhere.mkdir(parents=True)

    def folder(self, variant: Variant) -> Path:
        return self._folder / "".join(c if c.isalnum() or c in ".-" else "_" for c in variant.name)

    def compare(self, variant: Variant, base: Outcome) -> Difference | None:
        """Replay and compare; a replay that fails where the reference didn't is a difference too."""
        try:
            failed = self.replay(variant)
            if failed is None:
                other = Outcome(self.folder(variant))
                return first_difference(base, other, same_container=variant.form is None)
        except FbenchError as error:
            failed = error
        return Difference("replay", f"failed: {failed}")

    def replay(self, variant: Variant) -> FbenchError | None:
        """Replay in a fresh process; returns why it failed."""
        request = replace(self._request, rate=variant.rate, read_ahead=variant.read_ahead)
        task = VerifyTask(request, self.folder(variant), variant.form, variant.num_threads)
        threads = dict.fromkeys(_THREADS, str(variant.num_threads))
        process = subprocess.Popen(  # noqa: S603
            [sys.executable, "-P", "-m", self._worker],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8", errors="replace",
            env={**os.environ, **threads, "PYTHONHASHSEED": variant.hash_seed, **variant.environment},
            cwd=self._elsewhere if variant.elsewhere else None,
        )  # fmt: skip
        self._running.append(process)
        out, err = process.communicate(json.dumps(TASK.dump_python(task, mode="json")))
        if process.returncode == 0:
            return None
        lines = (line for text in (out, err) for line in reversed(text.splitlines()) if line.strip())
        last = next(lines, "no message")
        if process.returncode == EXIT_USAGE:
            return ConfigError(last)
        return LogError(last if out else f"exit code {process.returncode}: {last}")

    def kill(self) -> None:
        for process in self._running:
            if process.poll() is None:
                process.kill()


def _make_absolute(pipeline: str) -> str:
    """A pipeline as seen from any folder: `FILE.py:CLASS`, `FILE.toml`, files in the argument of `NAME:ARGUMENT`."""
    if pipeline.endswith(SUFFIX):
        return str(Path(pipeline).resolve())
    name = parse_name(pipeline)
    if name.argument is not None:
        return f"{name.plugin}:{with_absolute_files(name.argument)}"
    return pipeline if name.file is None else f"{name.file.resolve()}:{pipeline.rpartition(':')[2]}"


@contextmanager
def workplace(keep: Path | None) -> Iterator[Path]:
    """Give an empty folder, temporary or to be kept. Raises ConfigError where that isn't empty or can't be made."""
    if keep is None:
        with tempfile.TemporaryDirectory(prefix="fbench-verify-") as folder:
            yield Path(folder)
        return
    try:
        keep.mkdir(parents=True, exist_ok=True)
        used: Sequence[Path] = list(keep.iterdir())
    except OSError as error:
        raise output_error(keep, error) from error
    if used:
        raise ConfigError(f"{keep}: isn't empty; choose another with --keep")
    yield keep
