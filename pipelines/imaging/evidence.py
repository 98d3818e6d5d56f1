"""Points of LiDAR and radar in a camera's box that say how far away it is, and how fast."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.imaging.rays import nearest_dense
from fbench.pipelines.imaging.sightings import Sightings
from fbench.pipelines.imaging.spots import Points
from fbench.pipelines.points.radar import median_rate
from fbench.replay.arrays import Bool, Float64

_GATE = 2.5
_LEAST = 3
_FULL = 10.0
_AROUND_M = 2.5
"""Points that differ by less [m] from the depth of an object belong to it."""


@dataclass(frozen=True)
class Evidence:
    """What the points of one kind of sensor say of a box."""

    depth_m: float
    """Depth of the object they are on [m]."""
    strength: float
    """How much there is of it, 0 to 1."""
    rate_mps: float
    """Change of its distance [m/s], positive when receding; NaN where unknown."""


def evidence(seen: Sightings, at: int, points: Points) -> Evidence | None:
    """Find the nearest dense depth of the points in box `at`, near what the camera guesses; `None` without any."""
    inside = _inside(points, seen.xyxy_px[at])
    guess, std = seen.depth_m[at], seen.depth_std[at]
    if np.isfinite(guess):
        inside &= np.abs(np.log(np.maximum(points.depth_m, 0.1) / guess)) < _GATE * std
    depth = nearest_dense(np.sort(points.depth_m[inside]), _LEAST)
    if np.isnan(depth):
        return None
    on_it = inside & (np.abs(points.depth_m - depth) < _AROUND_M)
    num = int(np.count_nonzero(on_it))
    return Evidence(depth, float(1 - np.exp(-num / _FULL)), _rate(points, on_it))


def rate_at(points: Points, xyxy_px: Float64, depth_m: float) -> float:
    """Change of the distance [m/s] of what is in a box (4,) at a depth, by its echoes; NaN without any."""
    return _rate(points, _inside(points, xyxy_px) & (np.abs(points.depth_m - depth_m) < _AROUND_M))


def _inside(points: Points, xyxy_px: Float64) -> Bool:
    left, top, right, bottom = xyxy_px
    u, v = points.uv_px.T
    inside: Bool = (u > left) & (u < right) & (v > top) & (v < bottom)
    return inside


def _rate(points: Points, rows: Bool) -> float:
    own = points.cloud.own_mps[rows]
    if not np.isfinite(own).any():
        return float("nan")
    rate = median_rate(points.cloud.over_ground_mps[rows], points.cloud.period_mps[rows])
    return rate - float(np.nanmedian(own))
