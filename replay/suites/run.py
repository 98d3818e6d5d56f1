"""Runs the cells of a suite: those that are there stay, the others are replayed, a few at a time."""

import glob
import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Event

from fbench.replay.errors import ConfigError, FbenchError, one_line
from fbench.replay.suites.cell import Cell, CellResult
from fbench.replay.suites.content import Content, Contents, key_of
from fbench.replay.suites.seal import RUN_SEAL, is_sealed_run, seal_run
from fbench.replay.suites.workers import Workers

WORKER = "fbench.replay.cli.suite_worker"


def run_suite(
    cells: Sequence[Cell],
    num_workers: int,
    told: Callable[[int, int], None] = lambda done, of: None,
    module: str = WORKER,
) -> list[CellResult]:
    """Replay the cells whose runs aren't there, and return what became of all, in their order.

    A cell is there if its folder holds a whole run of equal content: log, files beside it, pipeline, parameters with
    weights, options of scoring, code and versions. What is damaged or of other content is replaced. A cell that fails
    doesn't stop the others; nor does one of known content that somebody changes before the suite ends, such as by
    `fbench score` with other options: its numbers would be of other rules than the rest. Runs are equal for any number
    of workers, apart from what is measured.

    Args:
        cells: With different folders.
        num_workers: Processes at a time, each on one thread.
        told: Told how many cells are done, of how many.
        module: What a process runs: a line with a cell on stdin, a line with an answer on stdout.

    Raises:
        ConfigError: where two cells have one folder, or there is no worker.
    """
    if num_workers < 1:
        raise ConfigError(f"--workers {num_workers}: expected at least 1")
    _require_own_folders(cells)
    told(0, len(cells))
    contents = Contents()
    with _suite(num_workers, module) as suite:
        begun = [suite.begin(cell, _planned(cell, contents)) for cell in cells]
        for num, _ in enumerate(as_completed([future for future, _ in begun]), 1):
            told(num, len(cells))
        results = [future.result() for future, _ in begun]
        return list(suite.pool.map(_checked, results, [planned for _, planned in begun]))


@dataclass(frozen=True)
class _Planned:
    """What is known of a cell before it is replayed."""

    content: Content | None = None
    error: str | None = None

    @property
    def key(self) -> str | None:
        """Of the run that it gives; `None` where nobody can tell."""
        return None if self.content is None else key_of(self.content)


def _planned(cell: Cell, contents: Contents) -> _Planned:
    try:
        return _Planned(contents.of(cell))
    except FbenchError as error:
        return _Planned(error=str(error))
    except Exception as error:  # noqa: BLE001  # a plug-in may raise anything, and mustn't stop the rest
        return _Planned(error=one_line(error))


@dataclass(frozen=True)
class _Suite:
    """What threads share."""

    pool: ThreadPoolExecutor
    workers: Workers
    interrupted: Event

    def begin(self, cell: Cell, planned: _Planned) -> tuple[Future[CellResult], _Planned]:
        """Hand a cell to the threads."""
        return self.pool.submit(self.result, cell, planned), planned

    def result(self, cell: Cell, planned: _Planned) -> CellResult:
        """Replay a cell, unless it is there; whatever goes wrong is its own failure."""
        try:
            return self._replayed(cell, planned)
        except FbenchError as error:
            return CellResult(cell, "failed", str(error))
        except OSError as error:
            return CellResult(cell, "failed", f"{cell.folder}: can't be made ({error.strerror or error})")
        except Exception as error:  # noqa: BLE001  # one cell mustn't stop the rest
            return CellResult(cell, "failed", one_line(error))

    def _replayed(self, cell: Cell, planned: _Planned) -> CellResult:
        if planned.error is not None:
            return CellResult(cell, "failed", planned.error)
        key = planned.key
        if key is not None and is_sealed_run(cell.folder, key):
            return CellResult(cell, "there")
        _clear(cell.folder)
        with self.workers.lent() as worker:
            if self.interrupted.is_set():
                return CellResult(cell, "failed", "interrupted")
            answer = worker.replay(cell)
        if answer.error is not None:
            _clear_partial(cell.folder)
            return CellResult(cell, "unfit" if answer.unfit else "failed", answer.error)
        if key is not None and planned.content is not None:
            seal_run(cell.folder, key, planned.content)
        return CellResult(cell, "replayed")


def _checked(result: CellResult, planned: _Planned) -> CellResult:
    """Fail a run that isn't as it was replayed any more."""
    key = planned.key
    if not result.has_run or key is None or is_sealed_run(result.cell.folder, key):
        return result
    return CellResult(result.cell, "failed", f"{result.cell.folder} was changed meanwhile; the same command redoes it")


@contextmanager
def _suite(num_workers: int, module: str) -> Iterator[_Suite]:
    """Give what threads share; where the `with` block ends early, no process is left and none begins."""
    workers, interrupted = Workers(module), Event()
    with ThreadPoolExecutor(num_workers) as pool:
        try:
            yield _Suite(pool, workers, interrupted)
        finally:
            interrupted.set()
            pool.shutdown(wait=False, cancel_futures=True)
            workers.end()
    workers.close()


def _clear(folder: Path) -> None:
    """Remove a damaged or old run of a suite, and make room for another."""
    if (folder / RUN_SEAL).exists():
        shutil.rmtree(folder)
    _clear_partial(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)


def _clear_partial(folder: Path) -> None:
    """Remove what a process that was killed has left."""
    for left in sorted(folder.parent.glob(f".{glob.escape(folder.name)}.partial-*")):
        shutil.rmtree(left, ignore_errors=True)


def _require_own_folders(cells: Sequence[Cell]) -> None:
    known: set[Path] = set()
    for cell in cells:
        folder = cell.folder.absolute()
        if folder in known:
            raise ConfigError(f"two cells of a suite go to {cell.folder}; give each a folder of its own")
        known.add(folder)
