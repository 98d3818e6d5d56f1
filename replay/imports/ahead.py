"""Reading ahead: files are read and parsed in a thread while what they hold is compressed and written."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
NUM_AHEAD = 4
"""Items; both sides take about as long, so that more wouldn't hide more."""


class _End:
    """Stands behind the last item."""


def ahead(items: Iterator[T]) -> Iterator[T]:
    """Yield the same items, up to `NUM_AHEAD` of which are asked for before they are wanted.

    All are asked for in one thread, one after the other. An error comes in the place of its item.
    """
    waiting: deque[Future[T | _End]] = deque()
    with ThreadPoolExecutor(1, "fbench-import") as pool:
        try:
            waiting.extend(pool.submit(next, items, _End()) for _ in range(NUM_AHEAD))
            while not isinstance(item := waiting.popleft().result(), _End):
                waiting.append(pool.submit(next, items, _End()))
                yield item
        finally:
            pool.shutdown(cancel_futures=True)
