"""Compiled search for the pairs of cells that may hold neighbours; cells and points are those of `grid_kernel`."""

import numpy as np

from fbench.pipelines.points.grid_kernel import FARTHEST_CELL, Pairs
from fbench.replay.arrays import Float64, Int64
from fbench.replay.kernels import kernel

ROUNDING = 0.25
"""The numbers of two points' cells are off by less than this together."""


@kernel
def may_touch(bounds: Float64, a: int, b: int) -> bool:
    """Tell whether two cells may hold neighbours, by the distance of their bounds, computed as that of points is."""
    x = max(bounds[a, 0] - bounds[b, 3], bounds[b, 0] - bounds[a, 3], 0.0)
    y = max(bounds[a, 1] - bounds[b, 4], bounds[b, 1] - bounds[a, 4], 0.0)
    z = max(bounds[a, 2] - bounds[b, 5], bounds[b, 2] - bounds[a, 5], 0.0)
    near: bool = x * x + y * y + z * z <= min(bounds[a, 6], bounds[b, 6])
    return near


@kernel
def _first_at_or_after(cells: Int64, begin: int, end: int, x: int, y: int, z: int) -> int:
    while begin < end:
        mid = (begin + end) // 2
        a, b = cells[mid, 1], cells[mid, 2]
        if a < x or (a == x and (b < y or (b == y and cells[mid, 3] < z))):
            begin = mid + 1
        else:
            end = mid
    return begin


@kernel
def _add_run(z: Int64, bounds: Float64, c: int, at: int, end: int, last: int, pairs: Pairs, num: int) -> int:
    """Append pairs of `c` and cells from `at` on, up to number `last` along z, that may touch it.

    Returns how many pairs there are now; those without room are only counted.
    """
    while at < end and z[at] <= last:
        if may_touch(bounds, c, at):
            if num < len(pairs):
                pairs[num, 0], pairs[num, 1] = c, at
            num += 1
        at += 1
    return num


@kernel
def find_in_level(cells: Int64, bounds: Float64, rows: Int64, reach: int, pairs: Pairs, num: int) -> int:
    """Append the pairs of cells (M, 4) of one level that may hold neighbours, each once, to `num` pairs.

    Rows of cells along z begin and end at `rows` (R + 1,). Neighbours are at most `reach` cells apart along each axis.
    Fills `pairs` (P, 2), and returns how many there are, which may be more than it has room for.
    """
    x, y, z = cells[rows[:-1], 1], cells[rows[:-1], 2], cells[:, 3].copy()
    near = np.zeros(reach + 1, np.int64)  # by steps along x: the first row that is near, or comes after
    for row in range(len(x)):
        near[0] = row
        for step in range(reach + 1):
            at, a, low, high = near[step], x[row] + step, y[row] - reach, y[row] + reach
            while at < len(x) and (x[at] < a or (x[at] == a and y[at] < low)):
                at += 1
            near[step] = at
            while at < len(x) and x[at] == a and y[at] <= high:
                num = _add_rows(z, bounds, (rows[row], rows[row + 1]), (rows[at], rows[at + 1]), reach, pairs, num)
                at += 1
    return num


@kernel
def _add_rows(
    z: Int64, bounds: Float64, one: tuple[int, int], other: tuple[int, int], reach: int, pairs: Pairs, num: int
) -> int:
    """Append pairs of cells of two rows, each given by where it begins and ends, or of one."""
    at, end = other
    for c in range(one[0], one[1]):
        while at < end and (z[at] < z[c] - reach or at <= c):
            at += 1
        num = _add_run(z, bounds, c, at, end, z[c] + reach, pairs, num)
    return num


@kernel
def find_in_higher(
    cells: Int64, bounds: Float64, lower: tuple[int, int], higher: tuple[int, int], edge: float, pairs: Pairs, num: int
) -> int:
    """As `find_in_level`, for cells `lower[0]` to `lower[1]` of one level and those of a higher one with this edge."""
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    begin, end = higher
    for c in range(lower[0], lower[1]):
        reach = np.sqrt(bounds[c, 6]) / edge + ROUNDING
        for axis in range(3):
            low[axis] = np.int64(min(max(np.floor(bounds[c, axis] / edge - reach), -FARTHEST_CELL), FARTHEST_CELL))
            high[axis] = np.int64(min(max(np.floor(bounds[c, axis + 3] / edge + reach), -FARTHEST_CELL), FARTHEST_CELL))
        for x in range(max(low[0], cells[begin, 1]), min(high[0], cells[end - 1, 1]) + 1):
            for y in range(low[1], high[1] + 1):
                at = _first_at_or_after(cells, begin, end, x, y, low[2])
                stop = _first_at_or_after(cells, at, end, x, y, high[2] + 1)
                num = _add_run(cells[:, 3], bounds, c, at, stop, high[2], pairs, num)
    return num
