"""Boxes reduced to what matching needs to know of them."""

from dataclasses import dataclass, fields

import numpy as np

from fbench.replay.arrays import Array, Bool, Float64, Int64, Text
from fbench.replay.boxes import Boxes2D
from fbench.replay.data import Boxes


@dataclass(frozen=True, eq=False)
class Items:
    """N boxes of one image or of the ground plane."""

    place: Float64
    """(N, 2) centre in the ground plane [m], or (N, 4) rectangle [px]; 0 where not `valid`."""
    valid: Bool
    """(N,) false where the box or its score isn't finite."""
    inside: Bool
    """(N,) in the region of interest."""
    label: Text
    """(N,) empty where the class isn't known."""
    track_id: Int64
    """(N,) negative where there is none."""
    score: Float64
    """(N,) 0 where there is none."""
    ignore: Bool
    """(N,) neither a hit nor a miss."""

    def __len__(self) -> int:
        return len(self.valid)

    def __getitem__(self, rows: Array) -> "Items":
        """Select rows by mask or index array."""
        return Items(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def make_items(boxes: Boxes, place: Float64, valid: Bool, inside: Bool) -> Items:
    """Reduce N boxes to items with the given place, validity and region; keeps their order."""
    n = len(boxes)
    return Items(
        place=np.where(valid[:, None], place, 0.0),
        valid=valid,
        inside=inside,
        label=np.full(n, "") if boxes.label is None else boxes.label,
        track_id=np.full(n, -1) if boxes.track_id is None else boxes.track_id,
        score=np.zeros(n) if boxes.score is None else boxes.score,
        ignore=np.zeros(n, bool) if boxes.ignore is None else boxes.ignore,
    )


def canonical(boxes: Boxes) -> Boxes:
    """Sort boxes by their content, so that the order in which a pipeline gives them never decides a match."""
    keys: list[Array] = [boxes.camera] if isinstance(boxes, Boxes2D) else []
    keys += [*boxes.geometry.T]
    keys += [k for k in (boxes.score, boxes.label, boxes.track_id) if k is not None]
    return boxes[np.lexsort(keys[::-1])]
