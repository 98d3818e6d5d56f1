"""Poses from `GPS_IMU_Twist`.

A file has 18 lines (README of the SDK): latitude, longitude [deg] and altitude [m]; a covariance (3 lines); the IMU's
quaternion x, y, z, w; turn rates; accelerations; covariances (9 lines); velocity; turn rates. The README doesn't say
whose axes these are. In the sequence that came with the SDK the velocity is north, east, down: that is how positions
move.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.datasets.radiate.files import GPS
from fbench.datasets.radiate.params import RadiateParams
from fbench.replay.boxfiles.parse import number
from fbench.replay.data import Float64, Pose
from fbench.replay.errors import LogError
from fbench.replay.imports.files import read_text

_COUNTS = (3, 3, 3, 3, 4, *[3] * 13)
_PLACE, _QUATERNION, _VELOCITY = 0, 4, 16
_EARTH_M = 6_378_137.0
_FLATTENING = 1 / 298.257223563
"""WGS 84 (NIMA TR8350.2, table 3.1)."""
_UNIT = 1e-2


@dataclass(frozen=True, eq=False)
class Fix:
    """What a file tells."""

    lat_deg: float
    lon_deg: float
    alt_m: float
    quaternion_xyzw: Float64
    north_east_mps: tuple[float, float]


def read_fix(path: Path) -> Fix:
    """Read a file.

    Raises:
        LogError: naming file and line that is missing or wrong.
    """
    lines = read_text(path, 100_000).splitlines()
    if len(lines) < len(_COUNTS):
        raise LogError(f"{path}: {len(lines)} lines, expected {len(_COUNTS)}, is it truncated?")
    lat, lon, alt = _numbers(path, lines, _PLACE)
    if not (abs(lat) < 90 and abs(lon) <= 180 and abs(alt) < _EARTH_M):
        raise LogError(f"{path}: line 1: latitude {lat:g}, longitude {lon:g}, altitude {alt:g} is no place on Earth")
    xyzw = _numbers(path, lines, _QUATERNION)
    if abs(sum(q * q for q in xyzw) - 1) > _UNIT:
        raise LogError(
            f"{path}: line {_QUATERNION + 1}: expected a unit quaternion, got {lines[_QUATERNION].strip()[:80]}"
        )
    north, east, _ = _numbers(path, lines, _VELOCITY)
    return Fix(lat, lon, alt, np.array(xyzw), (north, east))


def _numbers(path: Path, lines: list[str], index: int) -> list[float]:
    where = f"{path}: line {index + 1}"
    texts = lines[index].strip().split(",")
    values = [number(text, where, "a value") for text in texts]
    if len(values) != _COUNTS[index] or not all(abs(value) < 1e9 for value in values):
        raise LogError(f"{where}: expected {_COUNTS[index]} finite numbers")
    return values


class Poses:
    """Makes poses of fixes one after the other.

    World: east, north, up, touching the ellipsoid's normal at the first fix, where the origin is. The place of the
    antenna on the van isn't published, and taken for the body's origin.
    """

    def __init__(self, params: RadiateParams) -> None:
        self._params = params
        self._origin: Fix | None = None
        self._yaw_rad: float | None = None

    def pose(self, fix: Fix, stamp_ns: int) -> Pose | None:
        """Return the pose at a fix; `None` where it isn't known yet where the body points to."""
        rotation = self._rotation(fix)
        if rotation is None:
            return None
        self._origin = self._origin or fix
        return Pose(GPS, stamp_ns, stamp_ns, east_north_up_m(fix, self._origin), rotation)

    def _rotation(self, fix: Fix) -> Float64 | None:
        if self._params.heading == "imu":
            return fix.quaternion_xyzw
        north, east = fix.north_east_mps
        if math.hypot(north, east) >= self._params.min_speed_mps:
            self._yaw_rad = math.atan2(north, east)
        if self._yaw_rad is None:
            return None
        return np.asarray(Rotation.from_euler("z", self._yaw_rad).as_quat(canonical=True), np.float64)


def east_north_up_m(fix: Fix, origin: Fix) -> Float64:
    """Position (3,) [m] in the plane that touches the Earth at another fix; B. Hofmann-Wellenhof, H. Lichtenegger and
    E. Wasle, "GNSS", Springer 2008, section 8.2.
    """
    lat, lon = math.radians(origin.lat_deg), math.radians(origin.lon_deg)
    x, y, z = _earth_fixed_m(fix) - _earth_fixed_m(origin)
    forth = math.cos(lon) * x + math.sin(lon) * y
    east = math.cos(lon) * y - math.sin(lon) * x
    north = math.cos(lat) * z - math.sin(lat) * forth
    return np.array([east, north, math.cos(lat) * forth + math.sin(lat) * z])


def _earth_fixed_m(fix: Fix) -> Float64:
    lat, lon = math.radians(fix.lat_deg), math.radians(fix.lon_deg)
    squared = _FLATTENING * (2 - _FLATTENING)
    normal = _EARTH_M / math.sqrt(1 - squared * math.sin(lat) ** 2)
    across = (normal + fix.alt_m) * math.cos(lat)
    return np.array(
        [across * math.cos(lon), across * math.sin(lon), (normal * (1 - squared) + fix.alt_m) * math.sin(lat)]
    )
