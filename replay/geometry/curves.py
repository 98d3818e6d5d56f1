"""Edges and faces of boxes as a lens sees them that bends straight lines."""

import numpy as np

from fbench.replay.arrays import Bool, Float64

EDGES = np.array([(i, j) for i in range(8) for j in range(i + 1, 8) if (i ^ j) in (1, 2, 4)])
"""Corners (12, 2) at both ends of each edge, numbered as `corners` does."""


def curves(points: Float64, num: int, near_m: float) -> Float64:
    """Points (N, 12, `num`, 3) along the edges of boxes with corners (N, 8, 3) in camera coordinates [m].

    They are evenly spread as seen from the camera. Edges are cut off where they come nearer to the image plane than
    `near_m`, NaN where nothing is left; with 0 they stay whole.
    """
    a, b = points[:, EDGES[:, 0]], points[:, EDGES[:, 1]]
    if near_m > 0:
        a, b = _cut(a, b, near_m * (1 + 1e-9))
    length_a, length_b = _length(a), _length(b)
    share = np.linspace(0.0, 1.0, num)
    # The point on the edge whose direction is (1 - share) a/|a| + share b/|b|.
    with np.errstate(invalid="ignore", divide="ignore"):
        at = share * length_a / ((1 - share) * length_b + share * length_a)
    at = np.where(np.isfinite(at), at, share)[..., None]
    return np.asarray((1 - at) * a[:, :, None] + at * b[:, :, None], np.float64)


def _cut(a: Float64, b: Float64, near_m: float) -> tuple[Float64, Float64]:
    za, zb = a[..., 2], b[..., 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = ((near_m - za) / (zb - za))[..., None]
        crossing = a + share * (b - a)
    behind_a, behind_b = (za < near_m)[..., None], (zb < near_m)[..., None]
    crossing = np.where(behind_a & behind_b, np.nan, crossing)
    crossing[..., 2] = np.where(np.isnan(crossing[..., 2]), np.nan, near_m)
    return np.where(behind_a, crossing, a), np.where(behind_b, crossing, b)


def _length(xyz: Float64) -> Float64:
    return np.asarray(np.sqrt((xyz * xyz).sum(axis=2))[..., None], np.float64)


def border_hits(points: Float64, rays: Float64, near_m: float) -> Bool:
    """Tell which rays (M, 3) from the origin meet which boxes with corners (N, 8, 3) farther than `near_m`: (N, M)."""
    axes = points[:, [1, 2, 4]] - points[:, :1]
    square = (axes * axes).sum(axis=2)
    scaled = axes / np.where(square > 0, square, 1.0)[..., None]
    # In units of the box, whose corners are 0 and 1, along its axes.
    origin = -(scaled * points[:, :1]).sum(axis=2)[:, None]
    ahead = (rays[None, :, None] * scaled[:, None]).sum(axis=3)
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = -origin / ahead, (1 - origin) / ahead
    inside = (ahead == 0) & (origin >= 0) & (origin <= 1)
    enter = np.where(inside, -np.inf, np.fmin(first, second)).max(axis=2, initial=-np.inf)
    leave = np.where(inside, np.inf, np.fmax(first, second)).min(axis=2, initial=np.inf)
    return np.asarray((leave > enter) & (leave > near_m) & (square > 0).all(axis=1)[:, None], np.bool_)
