"""Orders of boxes and tracks by their content, so that ids and the order of rows decide nothing."""

from collections.abc import Sequence

import numpy as np

from fbench.replay.data.arrays import Array, Int64
from fbench.replay.data.sequences import Objects


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

    The one that goes on comes before the one that ends. `box` (N,) are `content_ranks` of the boxes, with time as the
    first column, `track` (N,) is any number for each track; where all boxes of two are equal the lower one comes first.
    """
    order = np.lexsort((box, track))
    names, first = np.unique(track[order], return_index=True)
    lives = [[*part.tolist(), len(box)] for part in np.split(box[order], first[1:])]
    rank = np.empty(len(names), np.int64)
    rank[sorted(range(len(names)), key=lambda k: lives[k])] = np.arange(len(names))
    return rank[np.searchsorted(names, track)]


def content_order(objects: Objects) -> Int64:
    """Return the rows (N,) by step, place, size, score, class and what else is known of the boxes, so that the order in
    which they come never decides a match. Equal boxes go by the life of their tracks: ids are names only.
    """
    o = objects
    geometry = (o.center_m, o.size_lwh_m, o.yaw_rad, o.xyxy_px)
    others = (o.score, o.distance_m, o.range_rate_mps, o.visibility, o.sources, o.ignore, o.inside, o.seen, o.label)
    columns = [column for values in geometry if values is not None for column in np.atleast_2d(values.T)]
    columns += [column for column in (*others, o.predicted) if column is not None]
    box = content_ranks([o.step, *columns])
    if len(box) and int(box.max()) + 1 < len(box):
        return np.lexsort((life_ranks(box, o.track_id), box))
    return np.argsort(box, kind="stable")


def number_tracks(track_id: Int64, stream: Int64) -> Int64:
    """Number the tracks (N,) from 0 on, by stream, then id; an id in two streams is two tracks."""
    if not len(track_id):
        return np.zeros(0, np.int64)
    numbers = np.unique(track_id, return_inverse=True)[1]
    if (stream != stream[0]).any():
        numbers = np.unique(stream * (int(numbers.max()) + 1) + numbers, return_inverse=True)[1]
    return np.asarray(numbers, np.int64)


def find_twice(step: Int64, track_id: Int64) -> int | None:
    """Return a row of the first step in which an id (N,) occurs twice, that of the lowest such id."""
    order = np.lexsort((track_id, step))
    twice = np.flatnonzero((np.diff(step[order]) == 0) & (np.diff(track_id[order]) == 0))
    return int(order[twice[0]]) if len(twice) else None
