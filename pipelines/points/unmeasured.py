"""Radar echoes whose velocity nothing measured: which of them may be vehicles, moving or not."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from fbench.pipelines.checks import require_ranges
from fbench.pipelines.points.clustering import Grouping
from fbench.replay.arrays import Bool, Float64, Int64


@dataclass(frozen=True)
class UnmeasuredParams:
    """What echoes without velocity must be like, since standing things can't be told from moving ones by it."""

    strongest: float = 0.25
    """Share of the echoes of one scan [0 to 1], the strongest, that is clustered; those of unknown magnitude are."""
    least_kept: int = 200
    """So many of a scan's strongest echoes are clustered at least: sparse scans hold little that is weak."""
    max_length_m: float = 15.0
    """Longer clusters [m] are walls and hedges."""
    max_width_m: float = 4.5
    """Wider clusters [m] are buildings and trees."""

    def __post_init__(self) -> None:
        ranges = {
            "strongest": (0.0, 1.0), "least_kept": (0, 1e6), "max_length_m": (0.1, 1000.0),
            "max_width_m": (0.1, 1000.0),
        }  # fmt: skip
        require_ranges("radar.unmeasured", self, ranges)


def strong(magnitude_db: Float64, params: UnmeasuredParams) -> Bool:
    """Tell which echoes (N,) of one scan are among its strongest; equally strong ones are alike."""
    known = np.sort(magnitude_db[np.isfinite(magnitude_db)])
    num = max(round(params.strongest * len(known)), params.least_kept)
    if num >= len(known):
        return np.ones(len(magnitude_db), np.bool_)
    least = known[len(known) - num] if num else np.inf
    return np.asarray(~(magnitude_db < least), np.bool_)


def add_unmeasured(
    xyz: Float64, range_rate_mps: Float64, candidates: Bool, cluster: Int64, grouping: Grouping,
    params: UnmeasuredParams,
) -> Int64:  # fmt: skip
    """Give echoes without velocity (N,) a cluster, and return the clusters (N,) of all.

    What a radar with Doppler says about the place counts: of echoes it measured within the radius the nearest tells
    whether this is part of its moving cluster, or stands still. Others are clustered by place alone, and what is too
    large for a vehicle is left out. New clusters get the numbers after those in `cluster`, in the order of `grouping`.
    """
    result, measured = cluster.copy(), np.flatnonzero(np.isfinite(range_rate_mps))
    rows = np.flatnonzero(candidates & ~np.isfinite(range_rate_mps))
    if len(measured) and len(rows):
        distance, nearest = KDTree(xyz[measured, :2]).query(xyz[rows, :2])
        is_near = distance <= grouping.radii(np.hypot(xyz[rows, 0], xyz[rows, 1]))
        result[rows] = np.where(is_near, cluster[measured[nearest]], -1)
        rows = rows[~is_near]
    found = grouping.clusters(xyz[rows, :2], np.hypot(xyz[rows, 0], xyz[rows, 1]))
    number = int(cluster.max(initial=-1)) + 1
    for one in range(int(found.max(initial=-1)) + 1):
        members = rows[found == one]
        if _may_be_vehicle(xyz[members, :2], params):
            result[members] = number
            number += 1
    return result


def _may_be_vehicle(xy: Float64, params: UnmeasuredParams) -> bool:
    """Judge extents (N, 2) along and across the main axis, which is that of the largest variance."""
    x, y = (xy - xy.mean(axis=0)).T
    heading = 0.5 * np.arctan2(2 * (x * y).sum(), (x * x - y * y).sum())
    cos, sin = np.cos(heading), np.sin(heading)
    length, width = np.ptp(cos * x + sin * y), np.ptp(cos * y - sin * x)
    return bool(length <= params.max_length_m and width <= params.max_width_m)
