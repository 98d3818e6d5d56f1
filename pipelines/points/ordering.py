"""Sorting: rows by several columns, fast where few of them tie in the first; medians of few values."""

import numpy as np

from fbench.replay.arrays import Float64, Int64


def lexicographic_order(*columns: Float64) -> Int64:
    """Return the order (N,) of rows by the first column (N,), where that is equal by the second, and so on.

    The same as `np.lexsort(columns[::-1])`, about ten times as fast for measured coordinates: equal rows stay as they
    are, NaN comes last.
    """
    first = columns[0]
    order = np.argsort(first)
    ranked = first[order]
    same = ~(ranked[1:] > ranked[:-1])  # NaN with NaN, too
    if same.any():
        tied = np.flatnonzero(np.append(same, False) | np.append(False, same))
        rows = order[tied]
        order[tied] = rows[np.lexsort((rows, *(column[rows] for column in columns[::-1])))]
    return order


def median(values: Float64) -> float:
    """Median of at least one value (N,), none of them NaN: that of `np.median`, in a fifth of its time for a few."""
    ranked = np.sort(values)
    return float((ranked[(len(ranked) - 1) // 2] + ranked[len(ranked) // 2]) / 2)
