"""Compiled grid of cells so small that points in one cell are always neighbours, and the pairs of cells that may touch.

Points are rows (x, y, z, r): coordinates and radius [same unit]; two are neighbours where their distance is at most the
smaller of their radii. Those with radii in [least * 2^k, least * 2^(k + 1)) are level k, whose cells have the edge
`edge_0 * 2^k`.
"""

import numpy as np
from numpy.typing import NDArray

from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.kernels import kernel

Pairs = NDArray[np.int32]
"""(P, 2) rows of cells."""
FARTHEST_CELL = 2.0**50
"""Numbers of cells are clipped here, where rounding moves a point by an eighth of a cell at most."""
_DIGIT = 11
_DIGITS = 1 << _DIGIT


@kernel
def cell_numbers(points: Float64, level: Int64, edge_0: float) -> Int64:
    """Return level and numbers of the cell along x, y, z of each point: (N, 4)."""
    result = np.empty((len(points), 4), np.int64)
    for i in range(len(points)):
        result[i, 0] = level[i]
        edge = edge_0 * 2.0 ** level[i]
        for axis in range(3):
            at = np.floor(points[i, axis] / edge)
            result[i, axis + 1] = np.int64(min(max(at, -FARTHEST_CELL), FARTHEST_CELL))
    return result


@kernel
def lexicographic(numbers: Int64) -> Int64:
    """Return the stable order of rows of `numbers` (N, K), the first column counting most: a radix sort."""
    order = np.arange(len(numbers))
    other = np.empty_like(order)
    for column in range(numbers.shape[1] - 1, -1, -1):
        low = numbers[:, column].min()
        span = numbers[:, column].max() - low
        shift = 0
        while span >> shift > 0:
            start = np.zeros(_DIGITS + 1, np.int64)
            for i in order:
                start[(((numbers[i, column] - low) >> shift) & (_DIGITS - 1)) + 1] += 1
            for digit in range(_DIGITS):
                start[digit + 1] += start[digit]
            for i in order:
                digit = ((numbers[i, column] - low) >> shift) & (_DIGITS - 1)
                other[start[digit]] = i
                start[digit] += 1
            order, other = other, order
            shift += _DIGIT
    return order


@kernel
def cells_of(rows: Float64, numbers: Int64, order: Int64) -> tuple[Float64, Int64, Int64]:
    """Put points (N, 4) in `order`, in which their `numbers` (N, K) are sorted.

    Returns the points, the different rows of `numbers` (M, K), and where the points of each begin, and N: (M + 1,).
    """
    points, cells, first = np.empty_like(rows), np.empty_like(numbers), np.empty(len(rows) + 1, np.int64)
    num = 0
    for i in range(len(order)):
        for axis in range(4):
            points[i, axis] = rows[order[i], axis]
        is_new = i == 0
        for k in range(numbers.shape[1]):
            cells[num, k] = numbers[order[i], k]
            is_new = is_new or cells[num, k] != cells[num - 1, k]
        if is_new:
            first[num] = i
            num += 1
    first[num] = len(order)
    return points, cells[:num], first[: num + 1]


@kernel
def row_starts(cells: Int64) -> Int64:
    """Return where runs of cells (M, 4 or more) begin that differ along z only, and M."""
    starts = np.empty(len(cells) + 1, np.int64)
    num = 0
    for c in range(len(cells)):
        if c == 0 or cells[c, 0] != cells[c - 1, 0] or cells[c, 1] != cells[c - 1, 1] or cells[c, 2] != cells[c - 1, 2]:
            starts[num] = c
            num += 1
    starts[num] = len(cells)
    return starts[: num + 1]


@kernel
def cell_bounds(points: Float64, first: Int64) -> tuple[Float64, Bool]:
    """Return lowest and highest x, y, z and the largest radius squared of each cell (M, 7).

    And whether all points of a cell are neighbours (M,), which rounding prevents where coordinates are huge.
    """
    bounds, small = np.empty((len(first) - 1, 7)), np.empty(len(first) - 1, np.bool_)
    for c in range(len(first) - 1):
        diagonal = 0.0
        for axis in range(3):
            low = high = points[first[c], axis]
            for i in range(first[c] + 1, first[c + 1]):
                low, high = min(low, points[i, axis]), max(high, points[i, axis])
            bounds[c, axis], bounds[c, axis + 3] = low, high
            diagonal += (high - low) * (high - low)
        least = most = points[first[c], 3]
        for i in range(first[c] + 1, first[c + 1]):
            least, most = min(least, points[i, 3]), max(most, points[i, 3])
        bounds[c, 6] = most * most
        # Rounding is monotonic: what holds for the diagonal as computed holds for all distances as computed.
        small[c] = diagonal <= least * least
    return bounds, small
