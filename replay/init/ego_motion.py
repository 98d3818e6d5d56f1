"""The vehicle's own motion, from one radar scan or from poses."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.data import Pose, RadarScan

_MAX_POINTS = 100
_MIN_POINTS = 8
_MIN_ANGLE_SINE = 0.1
"""Two directions nearer to each other say little about a velocity."""
_TOLERANCE_MPS = 0.3
_MAX_SIDEWAYS = 0.35
"""Share of the speed along the vehicle that a sensor may move across, beyond 1 m/s."""
_MAX_SPEED_MPS = 80.0


class Fit(NamedTuple):
    """How most points of a scan move, as things that stand still do: rate = a * direction."""

    along_mps: float
    """First component of `a` in body axes: negative where points ahead come nearer, as numbers say."""
    share: float
    """Share of the points that fit."""


def fit_scan(scan: RadarScan, body_R_sensor: Float64) -> Fit | None:
    """Fit radial velocities of things that stand still, `r = a . d` with `a = -v` where receding is positive, by trying
    all pairs of points (after Kellner et al., "Instantaneous ego-motion estimation using Doppler radar", ITSC 2013).

    Args:
        scan: With radial velocities (N,) [m/s].
        body_R_sensor: Rotation (3, 3).

    Returns:
        The fit that most points support, `None` where there are too few points.
    """
    if scan.radial_velocity_mps is None:
        return None
    directions, rate = _usable(scan, body_R_sensor)
    if len(rate) < _MIN_POINTS:
        return None
    tried = _pairs(directions, rate)
    tried = np.vstack([np.zeros(2), tried, np.column_stack([rate / _at_least(directions[:, 0]), np.zeros(len(rate))])])
    sideways = np.maximum(1.0, _MAX_SIDEWAYS * np.abs(tried[:, 0]))
    tried = tried[(np.abs(tried[:, 1]) <= sideways) & (np.abs(tried[:, 0]) <= _MAX_SPEED_MPS)]
    off = np.abs(tried[:, :1] * directions[:, 0] + tried[:, 1:] * directions[:, 1] - rate)
    num = np.count_nonzero(off < _TOLERANCE_MPS, axis=1)
    best = int(np.argmax(num))
    fits = off[best] < _TOLERANCE_MPS
    return Fit(float(np.median((rate[fits] - tried[best, 1] * directions[fits, 1]) / _at_least(directions[fits, 0])))
               if tried[best].any() else 0.0, float(num[best] / len(rate)))  # fmt: skip


def _usable(scan: RadarScan, body_R_sensor: Float64) -> tuple[Float64, Float64]:
    """Horizontal part of directions (N, 2) in body axes, and rates (N,), of at most so many points."""
    xyz = np.asarray(scan.xyz, np.float64)
    rate = np.asarray(scan.radial_velocity_mps, np.float64)
    distance = np.sqrt((xyz**2).sum(axis=1))
    good = np.flatnonzero(np.isfinite(distance) & np.isfinite(rate) & (distance > 1.0) & (distance < 1e6))
    unit = xyz[good] / distance[good, None]
    body = np.stack([unit[:, 0] * m[0] + unit[:, 1] * m[1] + unit[:, 2] * m[2] for m in body_R_sensor[:2]], axis=1)
    order = np.lexsort((rate[good], body[:, 1], body[:, 0]))
    kept = order[np.linspace(0, len(order) - 1, min(len(order), _MAX_POINTS)).astype(np.int64)] if len(order) else order
    return body[kept], rate[good][kept]


def _pairs(directions: Float64, rate: Float64) -> Float64:
    """Velocity (M, 2) that two points agree on, for all pairs whose directions differ enough."""
    i, j = np.triu_indices(len(rate), 1)
    a, b = directions[i], directions[j]
    det = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    apart = np.abs(det) > _MIN_ANGLE_SINE
    a, b, det, ra, rb = a[apart], b[apart], det[apart], rate[i][apart], rate[j][apart]
    found: Float64 = np.stack([(ra * b[:, 1] - rb * a[:, 1]) / det, (rb * a[:, 0] - ra * b[:, 0]) / det], axis=1)
    return found


def _at_least(values: Float64, least: float = 0.2) -> Float64:
    """Values whose magnitude isn't too small to divide by."""
    return np.where(values < 0, np.minimum(values, -least), np.maximum(values, least))


def forward_speed(poses: Sequence[Pose]) -> float | None:
    """Median speed along the body's x axis [m/s], of poses in the order of their stamps; `None`: there are too few."""
    speeds = []
    for first, second in zip(poses, poses[5:], strict=False):
        seconds = (second.stamp_ns - first.stamp_ns) / 1e9
        if 0 < seconds < 2 and np.any(first.rotation_xyzw):
            step = second.translation_m - first.translation_m
            speeds.append(float((step * first.world_T_body[:3, 0]).sum()) / seconds)
    return float(np.median(speeds)) if speeds else None
