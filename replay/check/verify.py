"""Verification: one task replayed under many circumstances, each in a fresh process, and compared."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

from fbench.replay.check.difference import Difference, Form, Outcome, VerifyTask, first_difference
from fbench.replay.contracts.errors import EXIT_USAGE, ConfigError, FbenchError, LogError
from fbench.replay.contracts.plugins import parse_name, with_absolute_files
from fbench.replay.contracts.variants import SUFFIX
from fbench.replay.geometry.kernels import VARIABLE
from fbench.replay.runs.folder import Run
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

    def task(self, request: ReplayRequest, folder: Path) -> VerifyTask:
        """Return the request under these circumstances."""
        varied = replace(request, rate=self.rate, read_ahead=self.read_ahead)
        return VerifyTask(varied, folder, self.form, self.num_threads)

    def variables(self) -> dict[str, str]:
        """What the process finds in its environment beside what is there anyway."""
        threads = dict.fromkeys(_THREADS, str(self.num_threads))
        return {**threads, "PYTHONHASHSEED": self.hash_seed, **self.environment}


BASE = Variant("reference")


def variants(num_repeats: int, span_s: float, quick: bool) -> tuple[Variant, ...]:
    """All circumstances to try, or only those that find most.

    Args:
        num_repeats: How often the same is replayed, the reference included.
        span_s: How long the log is, without pauses.
        quick: Leave out rates, reading ahead and containers.
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
class Verdict:
    """What a variant gave."""

    variant: str
    difference: Difference | None

    @property
    def identical(self) -> bool:
        """Whether it gave the same bits as the reference."""
        return self.difference is None


@dataclass(frozen=True)
class Verified:
    """All that was found."""

    digests: Mapping[str, str]  # Of the reference, by stage
    verdicts: tuple[Verdict, ...]

    @property
    def identical(self) -> bool:
        """Whether all gave the same bits."""
        return all(verdict.identical for verdict in self.verdicts)


def verify_in(
    request: ReplayRequest,
    num_repeats: int,
    quick: bool,
    folder: Path,
    worker: str,
    told: Callable[[int, int], None] = lambda done, of: None,
) -> Verified:
    """Replay under all circumstances; runs go into folders within `folder`.

    Args:
        request: What to replay; its pace, reading ahead and run folder don't matter.
        num_repeats: How often the same is replayed, the reference included.
        quick: Only the circumstances that find most.
        folder: An empty folder.
        worker: Module that replays one `VerifyTask`, given as JSON on stdin.
        told: Told how many replays are done, of how many.

    Raises:
        ConfigError, LogError: where the reference itself can't be replayed.
    """
    settings = [_absolute_value(setting) for setting in request.settings]
    moved = replace(request.absolute(), pipeline=_absolute(request.pipeline), settings=settings)
    children = _Children(moved, folder.resolve(), worker)
    with ThreadPoolExecutor(_AT_ONCE) as pool, children.ended(pool):
        failed = children.replay(BASE)
        if failed is not None:
            raise failed
        base = Outcome(children.folder(BASE))
        others = variants(num_repeats, _span_s(base.run), quick)
        told(1, len(others) + 1)
        futures = [pool.submit(children.verdict, variant, base) for variant in others]
        for num, _ in enumerate(as_completed(futures), 2):
            told(num, len(others) + 1)
        return Verified(base.digests, tuple(future.result() for future in futures))


class _Children:
    """Processes that replay."""

    def __init__(self, request: ReplayRequest, folder: Path, worker: str) -> None:
        self._request, self._folder, self._worker = request, folder, worker
        self._running: list[subprocess.Popen[str]] = []
        self._elsewhere = folder / "elsewhere"
        self._elsewhere.mkdir(parents=True)

    def folder(self, variant: Variant) -> Path:
        """Where a variant's run goes."""
        return self._folder / "".join(c if c.isalnum() or c in ".-" else "_" for c in variant.name)

    def verdict(self, variant: Variant, base: Outcome) -> Verdict:
        """Replay and compare; a replay that fails where the reference didn't is a difference too."""
        failed = self.replay(variant)
        if failed is not None:
            return Verdict(variant.name, Difference("replay", f"failed: {failed}"))
        try:
            return Verdict(
                variant.name, first_difference(base, Outcome(self.folder(variant)), same_container=variant.form is None)
            )
        except FbenchError as error:
            return Verdict(variant.name, Difference("replay", f"failed: {error}"))

    def replay(self, variant: Variant) -> FbenchError | None:
        """Replay in a fresh process; returns why it failed."""
        task = variant.task(self._request, self.folder(variant))
        process = subprocess.Popen(  # noqa: S603
            [sys.executable, "-P", "-m", self._worker],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, encoding="utf-8", errors="replace",
            env={**os.environ, **variant.variables()}, cwd=self._elsewhere if variant.elsewhere else None,
        )  # fmt: skip
        self._running.append(process)
        out, err = process.communicate(task.to_json())
        return None if process.returncode == 0 else _error(process.returncode, out, err)

    @contextmanager
    def ended(self, pool: ThreadPoolExecutor) -> Iterator[None]:
        """End all processes where the `with` block ends early, and begin none of those that wait in the pool."""
        try:
            yield
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in self._running:
                if process.poll() is None:
                    process.kill()


def _error(code: int, out: str, err: str) -> FbenchError:
    last = next((line for text in (out, err) for line in reversed(text.splitlines()) if line.strip()), "no message")
    return ConfigError(last) if code == EXIT_USAGE else LogError(last if out else f"exit code {code}: {last}")


def _span_s(run: Run) -> float:
    """How long a run is in log time, without pauses between segments."""
    steps = (b.stamp_ns - a.stamp_ns for a, b in pairwise(run.frames) if a.segment == b.segment)
    return sum(steps) / 1e9


def _absolute(text: str) -> str:
    """A pipeline as seen from any folder: `FILE.py:CLASS`, `FILE.toml`, files in the argument of `NAME:ARGUMENT`."""
    if text.endswith(SUFFIX):
        return str(Path(text).resolve())
    name = parse_name(text)
    if name.argument is not None:
        return f"{name.plugin}:{with_absolute_files(name.argument)}"
    return text if name.file is None else f"{name.file.resolve()}:{text.rpartition(':')[2]}"


def _absolute_value(setting: str) -> str:
    """`NAME=FILE`, or `NAME=COMMAND` with files in it, as seen from any folder."""
    name, equals, value = setting.partition("=")
    return f"{name}{equals}{with_absolute_files(value)}"


@contextmanager
def workplace(keep: Path | None) -> Iterator[Path]:
    """Give an empty folder, which goes away unless it is to be kept. Raises ConfigError where the folder to keep isn't
    empty or can't be made.
    """
    if keep is None:
        with tempfile.TemporaryDirectory(prefix="fbench-verify-") as folder:
            yield Path(folder)
        return
    try:
        keep.mkdir(parents=True, exist_ok=True)
        used: Sequence[Path] = list(keep.iterdir())
    except OSError as error:
        raise ConfigError(f"{keep}: can't be written ({error.strerror})") from error
    if used:
        raise ConfigError(f"{keep}: isn't empty; choose another with --keep")
    yield keep
