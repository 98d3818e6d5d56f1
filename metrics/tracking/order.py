"""An order of boxes that doesn't depend on how they were written down, for profiles where ties must not either."""

import numpy as np

from fbench.metrics.objects import Objects
from fbench.replay.arrays import Array, Int64


def by_content(objects: Objects, rows: Int64) -> Int64:
    """Order rows (K,) within their steps by box, then by the life of their tracks: ids are names only."""
    chosen = objects[rows]
    life = _lives(chosen)
    return np.asarray(rows[np.lexsort((life, *reversed(_columns(chosen)), chosen.step))])


def _columns(objects: Objects) -> list[Array]:
    """Numbers that tell boxes of a step apart, most important first."""
    boxes = (objects.xyxy_px, objects.center_m, objects.size_lwh_m)
    columns = [column for box in boxes if box is not None for column in box.T]
    return [*columns, *([] if objects.yaw_rad is None else [objects.yaw_rad]), objects.score]


def _lives(objects: Objects) -> Int64:
    """Rank (K,) of each box's track among all tracks, compared by their boxes from the first step on."""
    if not len(objects):
        return np.zeros(0, np.int64)
    columns = [objects.step.astype(float), *_columns(objects)]
    box = np.unique(np.column_stack(columns), axis=0, return_inverse=True)[1].ravel()
    order = np.lexsort((box, objects.track_id))
    ids, first = np.unique(objects.track_id[order], return_index=True)
    lives = [tuple(part) for part in np.split(box[order], first[1:])]
    rank = np.empty(len(ids), np.int64)
    rank[sorted(range(len(ids)), key=lambda k: lives[k])] = np.arange(len(ids))
    return np.asarray(rank[np.searchsorted(ids, objects.track_id)])
