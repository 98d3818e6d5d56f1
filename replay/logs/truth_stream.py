"""Joining the 3D and 2D messages of ground truth, in the order of their stamps."""

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import groupby

from fbench.replay.data import Truth
from fbench.replay.logs.truth_part import TruthPart

WINDOW = 256
"""Truth is put into the order of its stamps within so many, which bounds memory."""


def joined(parts: Iterable[TruthPart]) -> Iterator[Truth]:
    """Join parts that come in canonical order, and yield truth by (`stamp_ns`, `log_ns`).

    What comes more than `WINDOW` messages late, after a clock that jumped back, stays where it is.
    """
    heap: list[tuple[int, int, int, Truth]] = []
    for i, truth in enumerate(paired(parts)):
        heapq.heappush(heap, (truth.stamp_ns, truth.log_ns, i, truth))
        if len(heap) > WINDOW:
            yield heapq.heappop(heap)[3]
    while heap:
        yield heapq.heappop(heap)[3]


def paired(parts: Iterable[TruthPart]) -> Iterator[Truth]:
    """Join parts in the order in which they come: both have one `log_ns`, and in canonical order the topic of 3D truth
    comes first.
    """
    for _, group in groupby(parts, key=lambda part: part.truth.log_ns):
        truths: list[Truth] = []
        waiting: list[int] = []
        for part in group:
            mate = next((i for i in waiting if part.is_2d and _same(truths[i], part.truth)), None)
            if mate is not None:
                truths[mate] = replace(truths[mate], boxes2d=part.truth.boxes2d)
                waiting.remove(mate)
                continue
            if part.expects_2d:
                waiting.append(len(truths))
            truths.append(part.truth)
        yield from truths


def _same(a: Truth, b: Truth) -> bool:
    return a.stamp_ns == b.stamp_ns and a.frame_number == b.frame_number
