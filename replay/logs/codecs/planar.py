"""Planar LiDAR scans: ranges along rays of one plane become points with z = 0."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.contracts.errors import PointsError
from fbench.replay.data.arrays import Array, Bool, Float64
from fbench.replay.data.messages import PointCloud
from fbench.replay.logs.codecs.codec import Origin

_LIMIT_NS = np.iinfo(np.int32).max


@dataclass(frozen=True, eq=False)
class PlanarScan:
    """Ranges of one turn of the mirror, each with the angle of its ray."""

    frame_id: str
    stamp_ns: int
    angle_rad: Float64  # (N,), counted from x to y
    range_m: Array  # (N,)
    is_valid: Bool  # (N,)
    intensity: Array | None = None
    """(N,); (0,) where the sensor gives none."""
    time_s: Float64 | None = None  # (N,) after the stamp; `None` where the message doesn't say

    def to_sweep(self, origin: Origin) -> PointCloud:
        """Return the valid points. Raises PointsError where there are more or fewer intensities than ranges."""
        num, good = len(self.range_m), self.is_valid
        intensity = None if self.intensity is None or not len(self.intensity) else self.intensity
        if intensity is not None and len(intensity) != num:
            raise PointsError(f"scan has {num} ranges, but {len(intensity)} intensities")
        distance, angle = self.range_m[good].astype(np.float64), self.angle_rad[good]
        xyz = np.zeros((len(distance), 3), np.float32)
        xyz[:, 0], xyz[:, 1] = distance * np.cos(angle), distance * np.sin(angle)
        return PointCloud(
            origin.sensor, self.stamp_ns, origin.log_ns, xyz,
            None if intensity is None else intensity[good].astype(np.float32),
            offset_ns=_offsets(self.time_s, good), frame_number=origin.frame_number,
        )  # fmt: skip


def _offsets(time_s: Float64 | None, good: Bool) -> Array | None:
    if time_s is None:
        return None
    ns = np.rint(time_s[good] * 1e9)
    return ns.astype(np.int32) if bool((np.abs(ns) <= _LIMIT_NS).all()) else None


def find_valid(range_m: Array, low_m: float, high_m: float) -> Bool:
    """Tell which ranges (N,) are measurements: infinite ones have no return or one too near, NaN is an error (REP 117),
    and those outside the sensor's limits are to be left out; limits that make no sense are none.
    """
    good = np.isfinite(range_m) & (range_m > 0)
    if 0 <= low_m < high_m:
        good &= (range_m >= np.float32(low_m)) & (range_m <= np.float32(high_m))
    return good


def spread_rays(
    frame_id: str, stamp_ns: int, angles_rad: tuple[float, float], range_m: Float64, intensity: Float64
) -> PlanarScan:
    """Return a scan in Foxglove's form, whose rays are spread evenly from the first to the last of two angles; ranges
    of 0 have no return.
    """
    angle = np.linspace(*angles_rad, len(range_m))
    good = find_valid(range_m, 0.0, np.inf) & np.isfinite(angle)
    return PlanarScan(frame_id, stamp_ns, angle, range_m, good, intensity)
