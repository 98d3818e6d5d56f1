"""Where depth jumps in a LiDAR sweep, and where brightness does in an image."""

import numpy as np
from scipy.spatial import cKDTree

from fbench.replay.arrays import Array, Float32, Float64
from fbench.replay.images import Pixels

_SPREAD_RAD = (np.radians(0.8), np.radians(0.25))
"""How far a neighbour is away at most, in azimuth and altitude."""
_STEPS, _MAX_SPREAD_RAD = 1.25, np.radians(2.5)
"""A LiDAR whose shots lie farther apart in azimuth has its neighbours within so many steps."""
_NEIGHBOURS = 8
_MIN_STEP = 0.06
_MAX_RANGE_M = 60.0


def depth_edges(xyz: Array) -> Array:
    """Rows of the points (N, 3) [m], in coordinates of the sensor, behind which a neighbour in azimuth is over a meter
    and over 6 % farther away: the near side of an edge, which the image shows too.

    After J. Levinson and S. Thrun, "Automatic Online Calibration of Cameras and Lasers", RSS 2013.
    """
    p = np.asarray(xyz, np.float64)
    distance = np.sqrt(np.sum(p**2, axis=1))
    rows = np.flatnonzero((distance > 1.0) & (distance < 3 * _MAX_RANGE_M))
    if len(rows) < _NEIGHBOURS + 1:
        return np.zeros(0, np.int64)
    p, distance = p[rows], distance[rows]
    angles = np.stack([np.arctan2(p[:, 1], p[:, 0]), np.arcsin(np.clip(p[:, 2] / distance, -1, 1))], axis=1)
    scaled = angles / (_spread_rad(angles), _SPREAD_RAD[1])
    _, near = cKDTree(scaled).query(scaled, k=_NEIGHBOURS + 1, distance_upper_bound=1.0)
    far = np.append(distance, 0.0)[near].max(axis=1)  # the last row stands for no neighbour
    is_edge = (far - distance > np.maximum(1.0, _MIN_STEP * distance)) & (distance < _MAX_RANGE_M)
    return np.asarray(rows[is_edge], np.int64)


def _spread_rad(angles: Float64) -> float:
    """How far neighbours in azimuth may be apart, from azimuth and altitude (N, 2) of all points.

    A turn of few shots over many rings has steps of a degree: then no shot has any other within the usual spread.
    """
    aligned = angles / (_MAX_SPREAD_RAD, _SPREAD_RAD[1] / 4)  # of one ring
    near, _ = cKDTree(aligned).query(aligned, k=2, distance_upper_bound=1.0)
    steps = np.asarray(near, np.float64)[:, 1]
    found = steps[np.isfinite(steps)] * _MAX_SPREAD_RAD
    step = float(np.median(found)) if len(found) else 0.0
    return float(min(max(_SPREAD_RAD[0], _STEPS * step), _MAX_SPREAD_RAD))


def edge_strength(pixels: Pixels, width: int) -> Float32:
    """How near to an upright edge of brightness each pixel is, 0 to 1, of an image scaled to `width` (H, W).

    Upright, since jumps of depth between neighbours in azimuth are; others would only hide them. Edges spread some
    pixels, so that a calibration that is almost right is better than one that is far off.
    """
    import cv2

    height = max(1, round(pixels.shape[0] * width / pixels.shape[1]))
    gray = cv2.cvtColor(cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
    smooth = cv2.GaussianBlur(gray.astype(np.float32), (0, 0), 1.0)
    strength = np.abs(cv2.Sobel(smooth, cv2.CV_32F, 1, 0))
    top = max(float(np.quantile(strength, 0.95)), 1e-3)
    sharp = np.minimum(strength / top, 1).astype(np.float32)
    wide = [cv2.GaussianBlur(sharp, (0, 0), sigma) for sigma in (1.5, 4.0)]
    return np.asarray((sharp + wide[0] + wide[1]) / 3, np.float32)


def sampled(field: Float32, uv: Float64) -> Float64:
    """Values of a field (H, W) at the pixels (N, 2) nearest to `uv`; its mean where they are outside."""
    height, width = field.shape
    inside = (uv[:, 0] >= -0.5) & (uv[:, 0] < width - 0.5) & (uv[:, 1] >= -0.5) & (uv[:, 1] < height - 0.5)
    values = np.full(len(uv), float(field.mean(dtype=np.float64)))
    at = np.round(uv[inside]).astype(np.int64)
    values[inside] = field[at[:, 1], at[:, 0]]
    return values
