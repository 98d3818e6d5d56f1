"""An order of boxes and of tracks by what they are: ids are names only, and rows come in any order."""

from collections.abc import Sequence

import numpy as np

from fbench.replay.arrays import Array, Int64


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
