"""GPS and inertial measurements of KITTI (an OXTS RT 3003), and the poses that follow from them.

Rows of 30 values as in `oxts/dataformat.txt` of the raw data: latitude, longitude [deg], altitude [m], roll, pitch, yaw
[rad], then velocities, accelerations, turn rates, accuracies and states of the receiver.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.datasets.kitti.sensors import Calibration
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import read_text
from fbench.replay.data.arrays import Float64
from fbench.replay.data.messages import Pose
from fbench.replay.formats.text import parse_number
from fbench.replay.geometry.transforms import inverse, quaternion

SENSOR = "oxts"
NUM_VALUES = 30
EARTH_RADIUS_M = 6378137.0
_SHOWN = ("latitude", "longitude", "altitude", "roll", "pitch", "yaw")


@dataclass(frozen=True)
class Fix:
    """Where the IMU was, and how it was turned, in one row."""

    lat_deg: float
    lon_deg: float
    alt_m: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float  # 0 is east, counter-clockwise
    texts: tuple[str, str, str]  # Latitude, longitude and altitude as they were written


def fix_of(row: str, where: str) -> Fix:
    """Return what a row tells. Raises LogError where it hasn't 30 finite numbers, or isn't on Earth."""
    texts = row.split()
    if len(texts) != NUM_VALUES:
        raise LogError(f"{where}: {len(texts)} values, expected {NUM_VALUES}")
    names = [*_SHOWN, *(f"value {i + 1}" for i in range(len(_SHOWN), NUM_VALUES))]
    values = [parse_number(text, where, name) for name, text in zip(names, texts, strict=True)]
    for i in np.flatnonzero(~np.isfinite(values)).tolist():
        raise LogError(f"{where}: {names[i]} is '{texts[i][:40]}', expected a finite number")
    lat, lon, *others = values[:6]
    if not (abs(lat) < 90 and abs(lon) <= 180 and max(map(abs, others)) < EARTH_RADIUS_M):
        raise LogError(f"{where}: latitude {lat:g}, longitude {lon:g}, altitude {others[0]:g} is no place on Earth")
    alt, roll, pitch, yaw = others
    return Fix(lat, lon, alt, roll, pitch, yaw, (texts[0], texts[1], texts[2]))


def read_fix(path: Path) -> Fix:
    """Return the row of a file of the raw data, which has one. Raises LogError naming the file."""
    rows = [line for line in read_text(path).splitlines() if line.strip()]
    if len(rows) != 1:
        raise LogError(f"{path}: {len(rows)} rows, expected one")
    return fix_of(rows[0], str(path))


class World:
    """East, north, up, with the origin where the IMU was in the first row of the sequence.

    Positions are those of a Mercator projection that is true at the origin's latitude, as in `convertOxtsToPose.m` of
    the raw devkit: x = s R lon, y = s R ln tan(pi/4 + lat/2), s = cos(lat0). A sphere of radius R isn't quite the
    Earth: distances are up to 0.7% off.
    """

    def __init__(self, origin: Fix) -> None:
        names = ("lat_deg", "lon_deg", "alt_m")
        self.metadata = {f"world.origin_{name}": text for name, text in zip(names, origin.texts, strict=True)}
        self._scale = float(np.cos(np.deg2rad(origin.lat_deg)))
        self._origin_m = self._position(origin)

    def world_T_imu(self, fix: Fix) -> Float64:
        """Return the pose (4, 4) of the IMU (x forward, y left, z up): R = Rz(yaw) Ry(pitch) Rx(roll)."""
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("ZYX", [fix.yaw_rad, fix.pitch_rad, fix.roll_rad]).as_matrix()
        pose[:3, 3] = self._position(fix) - self._origin_m
        return pose

    def body_pose(self, fix: Fix, calibration: Calibration, stamp_ns: int, frame_number: int | None) -> Pose | None:
        """Return the body's pose; `None` where the calibration doesn't tell where the IMU is."""
        if calibration.body_T_imu is None:
            return None
        pose = self.world_T_imu(fix) @ inverse(calibration.body_T_imu)
        return Pose(SENSOR, stamp_ns, stamp_ns, pose[:3, 3], quaternion(pose[:3, :3]), frame_number)

    def _position(self, fix: Fix) -> Float64:
        north = np.log(np.tan(np.pi / 4 + np.deg2rad(fix.lat_deg) / 2))
        radius_m = self._scale * EARTH_RADIUS_M
        return np.array([radius_m * np.deg2rad(fix.lon_deg), radius_m * north, fix.alt_m])
