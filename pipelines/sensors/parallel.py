"""The sensor branches of one frame run in parallel, with the results that they have one after the other."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import partial
from typing import Any

from fbench.replay.contracts.params import StageClock
from fbench.replay.geometry.threads import num_threads


class Branches:
    """Threads for the branches of a frame; what decodes, detects and clusters runs without Python's lock.

    A branch takes the clock that times its stages, and gives its result. What it writes to (state of its stages, lists
    of faults) must be its own. The calling thread works too, so that there are no others where one is all there is.
    The others are started when first needed, and end with this object. `threads` may work at once; `None`:
    `num_threads()`.
    """

    def __init__(self, threads: int | None = None) -> None:
        self._num_others = (num_threads() if threads is None else threads) - 1
        self._pool: ThreadPoolExecutor | None = None

    def run(self, clock: StageClock, *branches: Callable[[StageClock], Any]) -> tuple[Any, ...]:
        """Run all branches, and return their results in the order given; name first what takes longest.

        All of them run, also when one fails; none is left running. `clock` gets the times of all stages in the order of
        branches; their sum may be more than the time that passed. Raises Exception that of the first branch, in the
        order given, that failed.
        """
        clocks = [StageClock() for _ in branches]
        runs = [(Future[Any](), partial(branch, own)) for branch, own in zip(branches, clocks, strict=True)]
        waiting, helpers = deque(runs), []
        for _ in range(min(self._num_others, len(runs) - 1)):
            self._pool = self._pool or ThreadPoolExecutor(self._num_others, "fbench-branch")
            helpers.append(self._pool.submit(_work_off, waiting))
        try:
            _work_off(waiting)
        finally:  # also when interrupted
            waiting.clear()
            wait([helper for helper in helpers if not helper.cancel()])
        results = []
        for (future, _), own in zip(runs, clocks, strict=True):
            results.append(future.result())
            clock.include(own)
        return tuple(results)


def _work_off(waiting: deque[tuple[Future[Any], partial[Any]]]) -> None:
    """Run what waits, until nothing does; other threads may do the same."""
    while True:
        try:
            future, branch = waiting.popleft()
        except IndexError:  # asking first could be too late when it is answered
            return
        try:
            future.set_result(branch())
        except BaseException as error:  # noqa: BLE001 - raised again by `Branches.run`
            future.set_exception(error)
