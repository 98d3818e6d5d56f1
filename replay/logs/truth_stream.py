"""Joining the 3D and 2D messages of ground truth, in the order of their stamps."""

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import groupby

from fbench.replay.data import Boxes2D, Boxes3D, Truth
from fbench.replay.logs.topics import BOXES2D, HAS_BOXES2D
from fbench.replay.logs.truth import read_boxes

WINDOW = 256
"""Truth is put into the order of its stamps within so many, which bounds memory."""


@dataclass(frozen=True, eq=False)
class TruthPart:
    """One message of truth: 3D, or 2D that belongs to a 3D one of the same instant where there is one."""

    truth: Truth
    is_2d: bool
    expects_2d: bool = False


def read_part(topic: str, data: bytes, stamp_ns: int, log_ns: int, frame_number: int | None) -> TruthPart:
    """Decode one message of truth.

    Raises:
        DecodeError: where it is damaged.
    """
    if topic == BOXES2D:
        boxes2d, _ = read_boxes(data, Boxes2D)
        return TruthPart(Truth(stamp_ns, log_ns, None, boxes2d, frame_number), is_2d=True)
    boxes3d, more = read_boxes(data, Boxes3D)
    return TruthPart(Truth(stamp_ns, log_ns, boxes3d, None, frame_number), False, more.get(HAS_BOXES2D) == "yes")


def joined(parts: Iterable[TruthPart]) -> Iterator[Truth]:
    """Join parts that come in canonical order, and yield truth by (`stamp_ns`, `log_ns`).

    What comes more than `WINDOW` messages late, after a clock that jumped back, stays where it is.
    """
    heap: list[tuple[int, int, int, Truth]] = []
    for i, truth in enumerate(_paired(parts)):
        heapq.heappush(heap, (truth.stamp_ns, truth.log_ns, i, truth))
        if len(heap) > WINDOW:
            yield heapq.heappop(heap)[3]
    while heap:
        yield heapq.heappop(heap)[3]


def _paired(parts: Iterable[TruthPart]) -> Iterator[Truth]:
    """Both parts have one `log_ns`, and in canonical order the topic of 3D truth comes first."""
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
