"""Messages of many blocks in canonical order, holding only blocks that overlap in time."""

import heapq
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from fbench.replay.logs.mcap_index import Block


class Entry(NamedTuple):
    """One message of the container; sorts canonically: (`log_ns`, topic, position in the topic's stream)."""

    log_ns: int
    topic: str
    block: int
    """Offset of its block in the file, and of itself in the block: together its position."""
    offset: int
    channel: int
    sequence: int
    publish_ns: int
    data: memoryview


def merged(blocks: Sequence[Block], load: Callable[[Block], list[Entry]]) -> Iterator[Entry]:
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
