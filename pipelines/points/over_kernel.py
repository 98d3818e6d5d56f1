"""Compiled count of points in rectangles."""

import numpy as np

from fbench.replay.arrays import Float64, Int64
from fbench.replay.kernels import kernel


@kernel
def count_inside(rectangles: Float64, xy: Float64, begin: Int64, end: Int64) -> Int64:
    """Count the points (N, 2) in each rectangle (M, 5): heading [rad], low along and across it, high along and across.

    Of rectangle m only points `begin[m]` to `end[m]` (M,) are looked at. Borders don't belong to it.
    """
    result = np.zeros(len(rectangles), np.int64)
    for m in range(len(rectangles)):
        c, s = np.cos(rectangles[m, 0]), np.sin(rectangles[m, 0])
        for i in range(begin[m], end[m]):
            u, v = c * xy[i, 0] + s * xy[i, 1], c * xy[i, 1] - s * xy[i, 0]
            if rectangles[m, 1] < u < rectangles[m, 3] and rectangles[m, 2] < v < rectangles[m, 4]:
                result[m] += 1
    return result
