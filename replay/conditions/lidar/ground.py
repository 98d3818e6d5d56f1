"""Wet ground: which points of a cloud are ground, and how much less of the light comes back from under water.

Hahner et al. 2022 (CVPR, snowfall simulation) for how water covers a road; Lekner and Dorf 1988 (Appl. Opt. 27) for why
it darkens it.
"""

from dataclasses import dataclass

import numpy as np

from fbench.replay.data.arrays import Array, Float64

WATER = 1.33  # Index of refraction
COVERING_MM = 1.2  # Depth from which on no grain of the road stands out of the water
_REACH_M, _CELL_M = 60.0, 0.2
_BANDS = (
    (0.5, 3),
    (0.5, 3),
    (0.3, 3),
    (0.4, 6),
    (0.4, 6),
    (0.4, 6),
    (0.3, 6),
    (0.2, 6),
)  # [m] about it, and its parameters
_MIN_POINTS = 50


@dataclass(frozen=True, eq=False)
class Ground:
    """Points on the ground."""

    rows: Array
    """(M,) of the cloud, ascending."""
    cos_incidence: Float64
    """(M,) between the beam and the ground's normal."""


def find_ground(body_xyz: Float64, origin_m: Float64) -> Ground | None:
    """Return the points of (N, 3), in body coordinates, within 0.2 m of the surface that most of the lower ones lie on,
    up to 60 m from a sensor at `origin_m` (3,). `None` where fewer than 50 do. Least squares in ever narrower bands, of
    a plane first, then, for hills and crowns, of a quadric; nothing is random.
    """
    along = body_xyz - origin_m
    flat_m = np.sqrt(along[:, 0] * along[:, 0] + along[:, 1] * along[:, 1])
    low = np.flatnonzero((flat_m < _REACH_M) & (along[:, 2] < -_CELL_M))
    if len(low) < _MIN_POINTS:
        return None
    x, y, z = along[low].T
    layer = np.floor(z / _CELL_M).astype(np.int64)
    counts = np.bincount(layer - layer.min())
    height = np.full(len(low), (int(np.argmax(counts)) + int(layer.min()) + 0.5) * _CELL_M)
    columns = np.stack([np.ones(len(low)), x, y, x * x, x * y, y * y])
    for band_m, num in _BANDS:
        inside = np.abs(z - height) < band_m
        if np.count_nonzero(inside) < _MIN_POINTS:
            return None
        used = columns[:num, inside]
        square = np.array([[float((a * b).sum()) for b in used] for a in used])
        surface = np.linalg.lstsq(square, np.array([float((a * z[inside]).sum()) for a in used]), rcond=None)[0]
        height = (surface[:, None] * columns[:num]).sum(axis=0)
    on = np.abs(z - height) < _BANDS[-1][0]
    x, y, z = x[on], y[on], z[on]
    slope = np.stack(
        [surface[1] + 2 * surface[3] * x + surface[4] * y, surface[2] + surface[4] * x + 2 * surface[5] * y]
    )
    across = np.abs(z - slope[0] * x - slope[1] * y) / np.sqrt((slope * slope).sum(axis=0) + 1)
    return Ground(low[on], np.minimum(across / np.sqrt(x * x + y * y + z * z), 1.0))


def wet_share(water_mm: float, cos_incidence: Float64) -> Float64:
    """Return the share (N,) of a dry road's reflectivity that it has under water: 1 - f + f T^2 / n^2. The water covers
    f = depth / 1.2 mm of it, at most all. Light gets into it by Fresnel's T, unpolarised, and by the same out of it,
    into a solid angle that is n^2 times as large. What is reflected to and fro within the film is left out.
    """
    covered = min(water_mm / COVERING_MM, 1.0)
    inside = np.sqrt(1 - (1 - cos_incidence * cos_incidence) / WATER**2)
    across = ((cos_incidence - WATER * inside) / (cos_incidence + WATER * inside)) ** 2
    parallel = ((WATER * cos_incidence - inside) / (WATER * cos_incidence + inside)) ** 2
    enters = 1 - (across + parallel) / 2
    return np.asarray(1 - covered + covered * enters * enters / WATER**2, np.float64)
