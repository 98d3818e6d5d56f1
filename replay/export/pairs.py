"""Which 2D box and which 3D box are one object."""

from collections import defaultdict, deque

import numpy as np

from fbench.replay.arrays import Array, Int64
from fbench.replay.boxes import Boxes2D, Boxes3D


def paired(flat: Boxes2D, solid: Boxes3D) -> Int64:
    """Return the 3D box (N,) of each 2D box, -1 where it has none.

    Boxes of one track id belong together. Those without an id do in their order, within a class as the source names it;
    ignore regions have no other half.
    """
    mates = np.full(len(flat), -1, np.int64)
    ids_flat, ids_solid = _ids(flat), _ids(solid)
    by_id = {id_: j for j, id_ in enumerate(ids_solid.tolist()) if id_ >= 0}
    mates[:] = [by_id.get(id_, -1) if id_ >= 0 else -1 for id_ in ids_flat.tolist()]
    waiting: defaultdict[str, deque[int]] = defaultdict(deque)
    for j in np.flatnonzero((ids_solid < 0) & ~_ignored(solid)).tolist():
        waiting[_class(solid, j)].append(j)
    for i in np.flatnonzero((ids_flat < 0) & ~_ignored(flat)).tolist():
        rows = waiting[_class(flat, i)]
        if rows:
            mates[i] = rows.popleft()
    return mates


def _ids(boxes: Boxes2D | Boxes3D) -> Int64:
    return np.full(len(boxes), -1, np.int64) if boxes.track_id is None else boxes.track_id


def _ignored(boxes: Boxes2D | Boxes3D) -> Array:
    return np.zeros(len(boxes), bool) if boxes.ignore is None else boxes.ignore


def _class(boxes: Boxes2D | Boxes3D, row: int) -> str:
    names = boxes.label if boxes.source_label is None else boxes.source_label
    return "" if names is None else str(names[row])
