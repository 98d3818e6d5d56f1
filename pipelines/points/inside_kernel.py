"""Compiled look at the points in rectangles."""

import numpy as np

from fbench.replay.arrays import Float64, Int64
from fbench.replay.kernels import kernel


@kernel
def points_inside(rectangles: Float64, points: Float64, begin: Int64, end: Int64) -> Float64:
    """Number of points (N, 3) in each rectangle (M, 5), and the highest third coordinate of them: (M, 2).

    Rectangles hold heading [rad], low along and across it, high along and across; borders don't belong to them. Of
    rectangle m only points `begin[m]` to `end[m]` (M,) are looked at. Without points the highest is -inf.
    """
    result = np.zeros((len(rectangles), 2))
    for m in range(len(rectangles)):
        c, s = np.cos(rectangles[m, 0]), np.sin(rectangles[m, 0])
        result[m, 1] = -np.inf
        for i in range(begin[m], end[m]):
            u, v = c * points[i, 0] + s * points[i, 1], c * points[i, 1] - s * points[i, 0]
            if rectangles[m, 1] < u < rectangles[m, 3] and rectangles[m, 2] < v < rectangles[m, 4]:
                result[m, 0] += 1.0
                result[m, 1] = max(result[m, 1], points[i, 2])
    return result
