"""Compiled search for the rectangle that best explains a cluster seen from one side."""

import numpy as np

from fbench.replay.arrays import Float64, Int64
from fbench.replay.kernels import kernel

HEADINGS_RAD = np.radians(np.arange(0.0, 90.0, 2.0))
"""Headings of rectangles in space that are tried; by then a rectangle looks as at the first again [rad]."""
NEAR_M = 0.05
"""Distances from an edge below this [m] are noise."""


@kernel
def fit_rectangles(xy: Float64, first: Int64, headings_rad: Float64, near_m: float) -> Float64:
    """Fit one rectangle to each cluster; points (N, 2) sorted by cluster, `first` (M + 1,) rows where clusters begin.

    Headings are searched for the largest closeness (Zhang et al., "Efficient L-shape fitting for vehicle detection
    using laser scanners", IV 2017, algorithm 4): the sum over points of 1 / distance to the nearest edge, distances
    below `near_m` counting as that. The first of equal headings wins.

    Returns (M, 6): heading [rad], low and high along the heading, low and high across it [m], and the mean distance
    of the points from the rectangle [m].
    """
    result = np.zeros((len(first) - 1, 6))
    for m in range(len(first) - 1):
        best = -1.0
        for heading in headings_rad:
            c, s = np.cos(heading), np.sin(heading)
            low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
            for i in range(first[m], first[m + 1]):
                u, v = xy[i, 0] * c + xy[i, 1] * s, xy[i, 1] * c - xy[i, 0] * s
                low_u, high_u = min(low_u, u), max(high_u, u)
                low_v, high_v = min(low_v, v), max(high_v, v)
            closeness = 0.0
            distance = 0.0
            for i in range(first[m], first[m + 1]):
                u, v = xy[i, 0] * c + xy[i, 1] * s, xy[i, 1] * c - xy[i, 0] * s
                d = min(u - low_u, high_u - u, v - low_v, high_v - v)
                closeness += 1.0 / max(d, near_m)
                distance += d
            if closeness > best:
                best = closeness
                num = first[m + 1] - first[m]
                result[m, 0] = heading
                result[m, 1], result[m, 2], result[m, 3], result[m, 4] = low_u, high_u, low_v, high_v
                result[m, 5] = distance / num
    return result
