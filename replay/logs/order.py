"""Canonical order, that in which entries sort, over many blocks; only blocks that overlap in time are held."""

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Protocol, TypeVar

from fbench.replay.logs.container import Entry


class Spanning(Protocol):
    """A part of a log that is read at once."""

    @property
    def start_ns(self) -> int:
        """No message of it has a smaller log time."""
        ...

    @property
    def offset(self) -> int:
        """Its place among the others."""
        ...


B = TypeVar("B", bound=Spanning)


def merged(blocks: Sequence[B], load: Callable[[B], Iterable[Entry]]) -> Iterator[Entry]:
    """Yield the messages of all blocks; a block is loaded when its time comes and dropped when it is used up."""
    heap: list[tuple[Entry, Iterator[Entry]]] = []
    for block in sorted(blocks, key=lambda b: (b.start_ns, b.offset)):
        while heap and heap[0][0].log_ns < block.start_ns:
            yield _pop(heap)
        entries = iter(load(block))
        first = next(entries, None)
        if first is not None:
            heapq.heappush(heap, (first, entries))
    while heap:
        yield _pop(heap)


def _pop(heap: list[tuple[Entry, Iterator[Entry]]]) -> Entry:
    entry, rest = heap[0]
    following = next(rest, None)
    if following is None:
        heapq.heappop(heap)
    else:
        heapq.heapreplace(heap, (following, rest))
    return entry
