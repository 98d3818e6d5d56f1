"""Orders of boxes and tracks by their content, so that ids and the order of rows decide nothing."""

from collections.abc import Sequence

import numpy as np

from fbench.metrics.core.sequence import Objects
from fbench.replay.data.arrays import Array, Int64


def content_ranks(columns: Sequence[Array]) -> Int64:
    """Return the rank (N,) of each row by its columns (N,), the most important first; rows equal in all have one rank.

    NaN comes last, and equals NaN.
    """
    num = len(columns[0])
    order = np.lexsort(tuple(reversed(columns)))
    differs = np.zeros(num, np.bool_)
    for column in columns:
        values = column[order]
        differs[1:] |= (values[1:] != values[:-1]) & ~((values[1:] != values[1:]) & (values[:-1] != values[:-1]))
    ranks = np.empty(num, np.int64)
    ranks[order] = np.cumsum(differs)
    return ranks


def life_ranks(box: Int64, track: Int64) -> Int64:
    """Return the rank (N,) of each box's track among all tracks, compared by their boxes from the first on.

    The one that goes on comes before the one that ends.

    Args:
        box: (N,) `content_ranks` of the boxes, with time as the first column.
        track: (N,) any number for each track; where all boxes of two are equal the lower one comes first.
    """
    order = np.lexsort((box, track))
    names, first = np.unique(track[order], return_index=True)
    lives = [[*part.tolist(), len(box)] for part in np.split(box[order], first[1:])]
    rank = np.empty(len(names), np.int64)
    rank[sorted(range(len(names)), key=lambda k: lives[k])] = np.arange(len(names))
    return rank[np.searchsorted(names, track)]


def in_order(objects: Objects) -> Objects:
    """Sort the boxes of each step by place, size, score, class and what else is known of them, so that the order in
    which they come never decides a match. Equal boxes go by the life of their tracks: ids are names only.
    """
    box = content_ranks([objects.step, *_columns(objects)])
    if len(box) and int(box.max()) + 1 < len(box):
        return objects[np.lexsort((life_ranks(box, objects.track_id), box))]
    return objects[np.argsort(box, kind="stable")]


def _columns(objects: Objects) -> list[Array]:
    """What tells the boxes of a step apart, most important first."""
    o = objects
    boxes = [box.T for box in (o.center_m, o.size_lwh_m) if box is not None]
    boxes += [] if o.yaw_rad is None else [o.yaw_rad[None]]
    boxes += [] if o.xyxy_px is None else [o.xyxy_px.T]
    others = (o.distance_m, o.range_rate_mps, o.visibility, o.sources, o.ignore, o.inside, o.seen)
    last = [] if o.predicted is None else [o.predicted]
    return [*(row for box in boxes for row in box), o.score, *(c for c in others if c is not None), o.label, *last]


def by_content(objects: Objects, rows: Int64) -> Int64:
    """Order rows (K,) within their steps by box, then by the life of their tracks: ids are names only."""
    chosen = objects[rows]
    box = content_ranks([chosen.step, *_order_columns(chosen)])
    return np.asarray(rows[np.lexsort((life_ranks(box, chosen.track_id), box))])


def _order_columns(objects: Objects) -> list[Array]:
    """What tells boxes of a step apart, most important first."""
    boxes = (objects.xyxy_px, objects.center_m, objects.size_lwh_m)
    columns = [column for box in boxes if box is not None for column in box.T]
    yaw = [] if objects.yaw_rad is None else [objects.yaw_rad]
    return [*columns, *yaw, objects.score, objects.label]
