"""Clusters of the merged cloud, by a density that knows what each sensor's points are worth."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.spatial import KDTree

from fbench.pipelines.fusion.early.cloud import FusedCloud
from fbench.pipelines.sensors.points.grid import find_root
from fbench.replay.contracts.params import CheckedParams, in_range
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import Source
from fbench.replay.geometry.kernels import kernel, kernel_part

Reaching: TypeAlias = tuple[Int64, Float64, Float64, Float64, float, float]
"""Neighborhoods: place, xy, reach, velocity and edge as of `connect_cells`, and the longest reach."""


@kernel_part
def _first_at_or_after(place: Int64, x: int, y: int) -> int:
    begin, end = 0, len(place)
    while begin < end:
        mid = (begin + end) // 2
        if place[mid, 0] < x or (place[mid, 0] == x and place[mid, 1] < y):
            begin = mid + 1
        else:
            end = mid
    return begin


@kernel_part
def _neighbors(i: int, reaching: Reaching, found: Int64) -> int:
    """Fill `found` with the cells within reach of cell `i`, itself included, and return how many there are."""
    place, xy, reach, velocity, edge, longest = reaching
    num = 0
    far = (reach[i] + longest) / 2
    steps = int(np.ceil(far / edge)) + 1
    for x in range(place[i, 0] - steps, place[i, 0] + steps + 1):
        at = _first_at_or_after(place, x, place[i, 1] - steps)
        while at < len(place) and place[at, 0] == x and place[at, 1] <= place[i, 1] + steps:
            dx, dy = xy[at, 0] - xy[i, 0], xy[at, 1] - xy[i, 1]
            gap = velocity[at] - velocity[i]
            within = (reach[i] + reach[at]) / 2
            # NaN: nothing measured it there, which fits anything
            if dx * dx + dy * dy + (0.0 if np.isnan(gap) else gap * gap) <= within * within:
                found[num] = at
                num += 1
            at += 1
    return num


@kernel
def connect_cells(
    place: Int64, xy: Float64, weight: Float64, able: Bool, reach: Float64, velocity: Float64, edge: float
) -> tuple[Int64, Bool]:
    """Cluster cells: core are those of `able` (M,) that have at least a weight of 1 within reach; clusters are
    connected core cells.

    Takes cell numbers (M, 2) in lexicographic order, and for each cell its place (M, 2) [m], weight (M,), reach (M,)
    [m] and velocity (M,) as a length [m], NaN where unknown. Two cells are neighbors where their distance is at most
    the mean of their reaches.

    Returns cluster numbers (M,), by the first core cell, -1 for noise, and which cells are core (M,). Border cells
    belong to the lowest-numbered cluster that reaches them.
    """
    num = len(place)
    reaching = (place, xy, reach, velocity, edge, reach.max() if num else 0.0)
    found, core = np.empty(num, np.int64), np.zeros(num, np.bool_)
    for i in range(num):
        total = 0.0
        for k in range(_neighbors(i, reaching, found)):
            total += weight[found[k]]
        core[i] = able[i] and total >= 1.0 - 1e-9  # sums of shares are rounded
    parent = np.arange(num)  # leads each core cell toward the first of its cluster
    for i in range(num):
        if core[i]:
            for k in range(_neighbors(i, reaching, found)):
                if core[found[k]]:
                    a, b = find_root(parent, i), find_root(parent, found[k])
                    parent[max(a, b)] = min(a, b)
    return _number_clusters(reaching, parent, core, found), core


@kernel_part
def _number_clusters(reaching: Reaching, parent: Int64, core: Bool, found: Int64) -> Int64:
    label, num_clusters = np.full(len(core), -1), 0
    for i in range(len(core)):
        if core[i]:
            root = find_root(parent, i)
            if root == i:
                label[i] = num_clusters
                num_clusters += 1
            else:
                label[i] = label[root]
    result = label.copy()
    for i in range(len(core)):
        if not core[i]:
            for k in range(_neighbors(i, reaching, found)):
                other = label[found[k]]
                if core[found[k]] and (result[i] < 0 or other < result[i]):
                    result[i] = other
    return result


@dataclass(frozen=True)
class DensityParams(CheckedParams, prefix="fusion.density"):
    """DBSCAN on the merged cloud, seen from above, over place and radial velocity.

    A point is worth 1 / its sensor's minimum, one of stereo the less the larger its error of depth is. Where the points
    within reach are worth 1 together, a cluster is.
    Standing echoes that no camera's box holds join clusters, but link nothing.
    """

    lidar_points: float = in_range(3.0, 0.01, 1e6)  # So many LiDAR points alone make a core.
    stereo_points: float = in_range(8.0, 0.01, 1e6)  # So many points of stereo alone make a core.
    moving_echoes: float = in_range(3.0, 0.01, 1e6)  # So many moving radar echoes alone make a core.
    standing_echoes: float = in_range(40.0, 0.01, 1e6)  # So many standing radar echoes alone make a core.
    seen_factor: float = in_range(2.0, 0, 1000)  # Points that a camera's box is given count so many times.
    reach_m: float = in_range(0.6, 0.01, 50)
    """Points of LiDAR and stereo nearer than this [m] to each other are neighbors."""
    reach_rad: float = in_range(0.03, 0, 1)
    """Beyond reach_m / this from the body's origin reaches grow with distance by this angle [rad], as the spacing of
    beams does."""
    radar_reach_m: float = in_range(2.0, 0.01, 50)
    """Largest reach of radar echoes [m]; it follows the spacing of moving echoes where that is less. Of two sensors
    the mean of both reaches counts."""
    seconds: float = in_range(1.0, 0, 100)
    """A difference in radial velocity of 1 m/s counts as a distance of this many meters [s]."""
    cell_m: float = in_range(0.2, 0.05, 10)
    """Points in one cell of this edge [m] are taken together, moving echoes with others of about their velocity."""

    def weights(self, cloud: FusedCloud, is_seen: Bool) -> Float64:
        """What each point (N,) is worth; `is_seen` (N,): a camera's box holds it."""
        echo = np.where(cloud.is_moving, 1 / self.moving_echoes, 1 / self.standing_echoes)
        dense = np.where(cloud.source == int(Source.L), 1 / self.lidar_points, 1 / self.stereo_points)
        worth = np.where(cloud.source == int(Source.R), echo, dense)
        return np.where(is_seen, self.seen_factor, 1.0) * worth * cloud.exactness


_FARTHEST_M = 1e6
_SPACINGS = 2.0  # Moving echoes reach so many times as far as the second next cell of such echoes lies
_PACE_MPS, _MOST_PACE = 1.0, 1000
"""Moving echoes in one cell are taken together where their velocities are in one step of this."""


def cluster_cloud(cloud: FusedCloud, is_seen: Bool, params: DensityParams) -> Int64:
    """Cluster a cloud; returns cluster numbers (N,), -1 for noise. `is_seen` (N,): a camera's box holds the point.
    Clusters are numbered by their first core cell, by x, then y. Points beyond 1000 km are noise.
    """
    result = np.full(len(cloud), -1)
    rows = np.flatnonzero((np.abs(cloud.xyz[:, :2]) < _FARTHEST_M).all(axis=1))
    if not len(rows):
        return result
    numbers = np.floor(cloud.xyz[rows, :2] / params.cell_m).astype(np.int64)
    # Ambiguous velocities are taken to [0, period), so that the seam lies at standstill.
    rate, period = cloud.range_rate_mps[rows], cloud.period_mps[rows]
    ambiguous = np.flatnonzero((period > 0) & np.isfinite(rate))
    rate[ambiguous] = np.mod(rate[ambiguous], period[ambiguous])
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
    result[rows] = connect_cells(numbers[first], xy, weight, able, reach, velocity, params.cell_m)[0][cell]
    return result


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
