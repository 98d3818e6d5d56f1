"""Clusters of the merged cloud, by a density that knows what each sensor's points are worth, and how far they reach."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from fbench.pipelines.checks import require_ranges
from fbench.pipelines.early.cloud import Cloud
from fbench.pipelines.early.density_kernel import connected
from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.data import Source


@dataclass(frozen=True)
class DensityParams:
    """DBSCAN on the merged cloud, seen from above, over place and radial velocity.

    A point is worth 1 / its sensor's minimum; where the points within reach are worth 1 together, a cluster is.
    Standing echoes that no camera's box holds join clusters, but link nothing.
    """

    lidar_points: float = 3.0
    """So many LiDAR points alone make a core."""
    stereo_points: float = 8.0
    """So many points of stereo alone make a core."""
    moving_echoes: float = 3.0
    """So many moving radar echoes alone make a core."""
    standing_echoes: float = 40.0
    """So many standing radar echoes alone make a core."""
    seen_factor: float = 2.0
    """Points that a camera's box is given count so many times."""
    reach_m: float = 0.6
    """Points of LiDAR and stereo nearer than this [m] to each other are neighbours."""
    reach_rad: float = 0.03
    """Beyond reach_m / this from the body's origin reaches grow with distance by this angle [rad], as the spacing of
    beams does."""
    radar_reach_m: float = 2.0
    """Largest reach of radar echoes [m]; it follows the spacing of moving echoes where that is less. Of two sensors
    the mean of both reaches counts."""
    seconds: float = 1.0
    """A difference in radial velocity of 1 m/s counts as a distance of this many metres [s]."""
    cell_m: float = 0.2
    """Points in one cell of this edge [m] are taken together, moving echoes with others of about their velocity."""

    def __post_init__(self) -> None:
        counts = ("lidar_points", "stereo_points", "moving_echoes", "standing_echoes")
        require_ranges("fusion.density", self, dict.fromkeys(counts, (0.01, 1e6)))
        ranges = {
            "seen_factor": (0.0, 1000.0), "reach_m": (0.01, 50.0), "reach_rad": (0.0, 1.0),
            "radar_reach_m": (0.01, 50.0), "seconds": (0.0, 100.0), "cell_m": (0.05, 10.0),
        }  # fmt: skip
        require_ranges("fusion.density", self, ranges)

    def weights(self, cloud: Cloud, is_seen: Bool) -> Float64:
        """What each point (N,) is worth; `is_seen` (N,): a camera's box holds it."""
        echo = np.where(cloud.is_moving, 1 / self.moving_echoes, 1 / self.standing_echoes)
        dense = np.where(cloud.source == int(Source.L), 1 / self.lidar_points, 1 / self.stereo_points)
        worth = np.where(cloud.source == int(Source.R), echo, dense)
        return np.where(is_seen, self.seen_factor, 1.0) * worth


_FARTHEST_M = 1e6
_SPACINGS = 2.0
"""Moving echoes reach so many times as far as the second next cell of such echoes lies."""
_PACE_MPS, _MOST_PACE = 1.0, 1000
"""Moving echoes in one cell are taken together where their velocities are in one step of this."""


def clusters(cloud: Cloud, is_seen: Bool, params: DensityParams) -> Int64:
    """Cluster a cloud; returns cluster numbers (N,), -1 for noise. `is_seen` (N,): a camera's box holds the point.

    Clusters are numbered by their first core cell, by x, then y. Points beyond 1000 km are noise.
    """
    result = np.full(len(cloud), -1)
    rows = np.flatnonzero((np.abs(cloud.xyz[:, :2]) < _FARTHEST_M).all(axis=1))
    if not len(rows):
        return result
    numbers = np.floor(cloud.xyz[rows, :2] / params.cell_m).astype(np.int64)
    rate = _unbroken_rates(cloud)[rows]
    pace = np.where(
        cloud.is_moving[rows], 1 + _MOST_PACE + np.clip(np.floor(rate / _PACE_MPS), -_MOST_PACE, _MOST_PACE), 0
    )
    # All fit into 63 bits: at most 2e7 cells to each side.
    key = (((numbers[:, 0] << 26) + numbers[:, 1]) << 11) + pace.astype(np.int64)
    _, first, cell = np.unique(key, return_index=True, return_inverse=True)
    num = np.bincount(cell)
    xy = np.stack([np.bincount(cell, cloud.xyz[rows, axis]) / num for axis in (0, 1)], axis=1)
    weight = np.asarray(np.bincount(cell, params.weights(cloud, is_seen)[rows]), np.float64)
    is_echo = np.bincount(cell, cloud.source[rows] != int(Source.R)) == 0
    known = is_echo & (np.bincount(cell, np.isfinite(rate)) > 0)
    mean = np.bincount(cell, np.where(cloud.is_moving[rows], rate, 0.0)) / num
    velocity = np.where(known, mean, np.nan) * params.seconds
    reach = _reaches(xy, is_echo, velocity, params)
    is_clutter = (cloud.source == int(Source.R)) & ~cloud.is_moving & ~is_seen
    able = np.bincount(cell, ~is_clutter[rows]) > 0
    result[rows] = connected(numbers[first], xy, weight, able, reach, velocity, params.cell_m)[0][cell]
    return result


def _unbroken_rates(cloud: Cloud) -> Float64:
    """Radial velocities (N,) [m/s]; ambiguous ones in [0, period), so that the seam lies at standstill."""
    rate = cloud.range_rate_mps.copy()
    rows = np.flatnonzero((cloud.period_mps > 0) & np.isfinite(rate))
    rate[rows] = np.mod(rate[rows], cloud.period_mps[rows])
    return rate


def _reaches(xy: Float64, is_echo: Bool, velocity: Float64, params: DensityParams) -> Float64:
    """Reach (M,) [m] of cells: LiDAR's grow with distance; those of radar alone follow the spacing of moving cells."""
    reach = np.maximum(params.reach_m, params.reach_rad * np.hypot(xy[:, 0], xy[:, 1]))
    moving = np.flatnonzero(is_echo & (np.nan_to_num(velocity) != 0))
    if len(moving) > 2:
        places = np.column_stack([xy[moving], velocity[moving]])
        spacing = np.asarray(KDTree(places).query(places, 3)[0])[:, 2]
        reach[moving] = np.clip(
            _SPACINGS * spacing, np.minimum(reach[moving], params.radar_reach_m), params.radar_reach_m
        )
    elif len(moving):
        reach[moving] = params.radar_reach_m
    return reach
