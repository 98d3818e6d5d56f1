"""Compiled search for the ground among the points of a frame."""

import numpy as np

from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.kernels import kernel


@kernel
def _at_rank(values: Float64, rank: int) -> int:
    """Return where the value lies that has this rank in ascending order; of equal ones the first has the lowest."""
    value = np.partition(values, rank)[rank]
    left = rank
    for one in values:
        if one < value:
            left -= 1
    for at, one in enumerate(values):
        if one == value:
            if left == 0:
                return at
            left -= 1
    return 0  # never: the value is one of them


@kernel
def lowest_rows(cell: Int64, z_m: Float64, outliers: float) -> Int64:
    """Return the row of the lowest point of each cell, cells in lexicographic order.

    Takes cells (N, 2) and heights (N,) [m] of at least one point; of equally low points the first counts. In each cell
    the share `outliers` of its lowest points is passed over.
    """
    low = (cell[:, 0].min(), cell[:, 1].min())
    wide = cell[:, 1].max() - low[1] + 1
    number = (cell[:, 0] - low[0]) * wide + cell[:, 1] - low[1]
    first = np.zeros(number.max() + 2, np.int64)
    for one in number:
        first[one + 1] += 1
    first = np.cumsum(first)
    rows, filled = np.empty(len(number), np.int64), first.copy()
    for row, one in enumerate(number):
        rows[filled[one]] = row
        filled[one] += 1
    result = np.empty(len(first), np.int64)
    num = 0
    for one in range(len(first) - 1):
        own = rows[first[one] : first[one + 1]]
        if len(own):
            result[num] = own[_at_rank(z_m[own], int(outliers * len(own)))]
            num += 1
    return result[:num]


@kernel
def heights(xyz: Float64, is_near: Bool, cell: Int64, plane: Float64, surface: Float64) -> Float64:
    """Height (N,) [m] of points (N, 3) above a plane, and, of those that are near, above a surface on it.

    `plane` holds its slopes and its height, `cell` (M, 2) the cells of `surface` (R, C) [m] under the near points.
    """
    result, num = np.empty(len(xyz)), 0
    for row in range(len(xyz)):
        result[row] = xyz[row, 2] - (plane[0] * xyz[row, 0] + plane[1] * xyz[row, 1] + plane[2])
        if is_near[row]:
            result[row] -= surface[cell[num, 0], cell[num, 1]]
            num += 1
    return result


@kernel
def fullest_bands(z_m: Float64, band_m: float) -> tuple[Int64, Int64]:
    """Return for each row of ascending heights (R, N) [m] how many lie within the fullest band, and where it begins.

    A band begins with one of the heights and includes both its ends; of equally full ones the lowest counts.
    """
    most, at = np.zeros(len(z_m), np.int64), np.zeros(len(z_m), np.int64)
    for row in range(len(z_m)):
        end = 0
        for begin in range(z_m.shape[1]):
            while end < z_m.shape[1] and z_m[row, end] <= z_m[row, begin] + band_m:
                end += 1
            if end - begin > most[row]:
                most[row], at[row] = end - begin, begin
    return most, at
