"""Running suites: cells that are there stay, the others are replayed, a few at a time, here or on a cluster."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from threading import Lock
from typing import Protocol, Self

from fbench.api.suites.cells import CellResult, Response, folder_of, is_sealed_run
from fbench.api.suites.process import Worker
from fbench.api.suites.runner import CellRunner, RunOptions, group_of, share_memory
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.setup.request import ReplayRequest


class Scheduler(Protocol):
    """Gives cells to whoever runs them; where its `with` block ends early, nothing is left running."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: object) -> None: ...

    def results(self, cells: Sequence[ReplayRequest]) -> Iterator[tuple[int, CellResult]]:
        """Yield the results with the indices of their cells, as they come."""


def run_suite(
    cells: Sequence[ReplayRequest],
    options: RunOptions,
    progress: Callable[[int, int], None] = lambda done, total: None,
    finished: Callable[[CellResult], None] = lambda result: None,
) -> list[CellResult]:
    """Replay the cells whose runs aren't there, and return what became of all, in their order. A cell is there if its
    folder holds a whole run of equal content: log, files beside it, pipeline, parameters with weights, options of
    scoring, code and versions. What is damaged or of other content is replaced. A cell that fails doesn't stop the
    others; nor does one of known content that somebody changes before the suite ends, such as by `fbench score` with
    other options: its numbers would be of other rules than the rest. Runs are equal for any number of processes, here
    or on a cluster, apart from what is measured. `progress` gets how many cells are done, and of how many; `finished`
    each result as it comes. Raises ConfigError where two cells have one folder, or the cluster can't be used.
    """
    known: set[Path] = set()
    for cell in cells:
        if (folder := folder_of(cell).absolute()) in known:
            raise ConfigError(f"two cells of a suite go to {folder_of(cell)}; give each a folder of its own")
        known.add(folder)
    progress(0, len(cells))
    results: dict[int, CellResult] = {}
    with _open_scheduler(options) as scheduler:
        for index, result in scheduler.results(cells):
            results[index] = result
            finished(result)
            progress(len(results), len(cells))
    with ThreadPoolExecutor(options.jobs) as pool:
        return list(pool.map(_check, [results[index] for index in range(len(cells))]))


def _open_scheduler(options: RunOptions) -> Scheduler:
    if not options.scheduler:
        return _Processes(options)
    from fbench.api.suites.cluster import DaskScheduler

    return DaskScheduler(options)


def _check(result: CellResult) -> CellResult:
    """Fail a run that isn't as it was replayed any more."""
    if not result.has_run or result.key is None or is_sealed_run(result.folder, result.key):
        return result
    return replace(result, state="failed", reason=f"{result.folder} was changed meanwhile; the same command redoes it")


class _Processes:
    """Processes on this machine, each with a thread of ours."""

    def __init__(self, options: RunOptions) -> None:
        self._runner = CellRunner(options)
        share = share_memory(options.jobs)
        self._workers = [Worker(options.module, share) for _ in range(options.jobs)]
        self._pool = ThreadPoolExecutor(options.jobs)
        self._queue = _Queue(())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._queue.close()
        for worker in self._workers:
            worker.end()
        self._pool.shutdown()
        for worker in self._workers:  # no thread has one any more
            worker.close()

    def results(self, cells: Sequence[ReplayRequest]) -> Iterator[tuple[int, CellResult]]:
        """Yield the results as they come."""
        self._queue = queue = _Queue(cells)
        done = SimpleQueue[tuple[int, CellResult] | BaseException]()
        for worker in self._workers:
            self._pool.submit(self._work, worker, queue, cells, done)
        for _ in cells:
            item = done.get()
            if isinstance(item, BaseException):
                raise item
            yield item

    def _work(
        self, worker: Worker, queue: "_Queue", cells: Sequence[ReplayRequest],
        done: SimpleQueue[tuple[int, CellResult] | BaseException],
    ) -> None:  # fmt: skip
        try:
            group = None
            while (found := queue.take(group)) is not None:
                group, index = found
                done.put((index, self._runner.run(cells[index], partial(_replay, queue, worker))))
        except BaseException as error:  # noqa: BLE001  # raised where results are waited for
            done.put(error)


def _replay(queue: "_Queue", worker: Worker, cell: ReplayRequest) -> Response:
    return Response("interrupted") if queue.is_closed else worker.replay(cell)


class _Queue:
    """Cells that wait, so that one process gets those that need the same messages; where others are idle, they help."""

    def __init__(self, cells: Sequence[ReplayRequest]) -> None:
        groups: dict[str, deque[int]] = {}
        for index, cell in enumerate(cells):
            groups.setdefault(group_of(cell), deque()).append(index)
        self._waiting = deque(groups.values())
        self._begun: list[deque[int]] = []
        self._lock, self.is_closed = Lock(), False

    def take(self, group: deque[int] | None) -> tuple[deque[int], int] | None:
        """Return the next cell for who had one of `group` last, with its group; `None`: there is none any more."""
        with self._lock:
            if self.is_closed:
                return None
            if not group:
                if self._waiting:
                    group = self._waiting.popleft()
                    self._begun.append(group)
                else:
                    group = max(self._begun, key=len, default=None)
            self._begun = [one for one in self._begun if one]
            return (group, group.popleft()) if group else None

    def close(self) -> None:
        """Give nothing more."""
        with self._lock:
            self.is_closed = True
