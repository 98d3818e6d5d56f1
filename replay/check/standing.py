"""What stands on the ground in a sweep, seen from above: a small sample that outlives the sweep."""

import numpy as np

from fbench.replay.arrays import Array, Float32, Float64, Int64
from fbench.replay.geometry.transforms import transform

REACH_M = 64.0
"""Farther points [m from the body, along x or y] are left out."""
_CELL_M = 0.25
_GROUND_M = 4.0
_LOW_M, _HIGH_M = 0.4, 2.5
"""Points this far above the lowest one around them stand on the ground, but don't hang over it."""
_MAX_PLACES = 8000


def standing(xyz: Array, body_T_sensor: Float64) -> Float32:
    """Places (M, 2) [m] in body coordinates where something stands: of the points (N, 3) in the sensor's coordinates
    that are well above the lowest one of their 4 m, the mean of those in each quarter of a metre.

    The ground is told without knowing it, so that neither the mounting nor the heights of boxes matter. At most 8000
    places are given, evenly spread over all.
    """
    x, y, z = _near(xyz, body_T_sensor)
    coarse = _cells(x, y, _GROUND_M)
    lowest = np.full(int(coarse.max(initial=0)) + 1, np.inf)
    np.minimum.at(lowest, coarse, z)
    height = z - lowest[coarse]
    upright = np.flatnonzero((height > _LOW_M) & (height < _HIGH_M))
    return _means(x[upright], y[upright])


def echoes(xyz: Array, body_T_sensor: Float64) -> Float32:
    """Places (M, 2) [m] in body coordinates of radar points (N, 3), of any height: the road gives few echoes."""
    x, y, _ = _near(xyz, body_T_sensor)
    return _means(x, y)


def _near(xyz: Array, body_T_sensor: Float64) -> tuple[Float64, Float64, Float64]:
    x, y, z = (np.ascontiguousarray(column) for column in transform(body_T_sensor, xyz).T)
    near = np.flatnonzero((np.abs(x) < REACH_M) & (np.abs(y) < REACH_M) & np.isfinite(z))
    return x[near], y[near], z[near]


def _means(x: Float64, y: Float64) -> Float32:
    _, row, count = np.unique(_cells(x, y, _CELL_M), return_inverse=True, return_counts=True)
    sums = [np.bincount(row, weights=column, minlength=len(count)) for column in (x, y)]
    places = np.stack(sums, axis=1) / count[:, None]
    return places[:: -(-max(len(places), 1) // _MAX_PLACES)].astype(np.float32)


def _cells(x: Float64, y: Float64, edge_m: float) -> Int64:
    """Number of the square that each point is in."""
    across = round(2 * REACH_M / edge_m)
    return np.asarray(((x + REACH_M) / edge_m).astype(np.int64) * across + ((y + REACH_M) / edge_m).astype(np.int64))
