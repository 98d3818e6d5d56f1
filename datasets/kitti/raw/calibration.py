"""Calibration of a raw drive of KITTI.

Lines `NAME: numbers`, for camera X: S_0X, K_0X, D_0X, R_0X, T_0X as recorded, and S_rect_0X, R_rect_0X, P_rect_0X after
rectification; see the paper that `rig` names, section IV, and the readme of the raw data.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fbench.datasets.importing.files import is_pinhole, is_rotation, mount_of
from fbench.datasets.kitti.raw.files import Drive
from fbench.datasets.kitti.sensors import BODY_T_CAMERA0, LIDAR, Calibration, camera_name, rig_of
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import read_text
from fbench.replay.data.arrays import Float64
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.formats.text import parse_number
from fbench.replay.geometry.transforms import inverse, pose_matrix, quaternion

CAMERAS = "calib_cam_to_cam.txt"
LIDAR_TO_CAMERA = "calib_velo_to_cam.txt"
IMU_TO_LIDAR = "calib_imu_to_velo.txt"
FILES = (CAMERAS, LIDAR_TO_CAMERA, IMU_TO_LIDAR)
_MAX_MAGNITUDE = 1e9
_MAX_SIDE_PX = 2**16


@dataclass(frozen=True)
class Numbers:
    """The lines of one calibration file."""

    path: Path
    texts: Mapping[str, str]

    def array(self, name: str, *shape: int) -> Float64:
        """Return the numbers of a line. Raises LogError where it is missing, or lacks the finite numbers of `shape`."""
        if name not in self.texts:
            raise LogError(f"{self.path}: no line '{name}:'")
        where, texts = f"{self.path}: {name}", self.texts[name].split()
        if len(texts) != np.prod(shape):
            raise LogError(f"{where}: {len(texts)} numbers, expected {np.prod(shape)}")
        values = np.array([parse_number(text, where, "a value") for text in texts])
        if not (np.abs(values) < _MAX_MAGNITUDE).all():
            raise LogError(f"{where}: holds a number that isn't finite, or is beyond all reason")
        return values.reshape(shape)

    def rotation(self, name: str) -> Float64:
        """Return a matrix (3, 3). Raises LogError as `array`, and where it isn't a rotation."""
        R = self.array(name, 3, 3)
        if not is_rotation(R):
            raise LogError(f"{self.path}: {name}: isn't a rotation")
        return R

    def transform(self, rotation: str, translation: str) -> Float64:
        """Return a matrix (4, 4) from the lines of its rotation and translation [m]."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation(rotation), self.array(translation, 3)
        return matrix

    def size(self, name: str) -> tuple[int, int]:
        """Return width and height [px]."""
        width, height = self.array(name, 2).tolist()
        if not all(side == int(side) and 0 < side <= _MAX_SIDE_PX for side in (width, height)):
            raise LogError(f"{self.path}: {name}: {width:g}x{height:g} is no size of an image")
        return int(width), int(height)

    def pinhole(self, name: str, *shape: int) -> Float64:
        """Return a matrix that begins with K (3, 3). Raises LogError as `array`, and where K can't be one."""
        matrix = self.array(name, *shape)
        if not is_pinhole(matrix[:, :3]):
            raise LogError(f"{self.path}: {name}: isn't of the form fx s cx / 0 fy cy / 0 0 1")
        return matrix


@dataclass(frozen=True, eq=False)
class DriveCalibration:
    """What the files of a drive's date say."""

    rig: Rig
    calibration: Calibration  # Of the rectified cameras, by which the body's pose follows from that of the IMU
    made: str  # When the cameras were calibrated, as it is written; empty where it isn't

    @property
    def body_T_velo(self) -> Float64 | None:
        """(4, 4), as rigs hold it; `None` where the calibration doesn't tell it."""
        if self.calibration.camera0_T_velo is None:
            return None
        matrix = BODY_T_CAMERA0 @ self.calibration.camera0_T_velo
        return pose_matrix(matrix[:3, 3], quaternion(matrix[:3, :3]))


def read_calibration(drive: Drive) -> DriveCalibration:
    """Read a drive's calibration. LogError names a file that is missing or wrong; `calib_imu_to_velo.txt` may lack."""
    folder, has_lidar = drive.calibration_folder, LIDAR in drive.series
    cameras = _read(folder / CAMERAS)
    camera0_T_recorded = np.eye(4)
    camera0_T_recorded[:3, :3] = cameras.rotation("R_rect_00")
    numbers = drive.cameras.values()
    projections = {i: cameras.pinhole(f"P_rect_{i:02d}", 3, 4) for i in numbers} if drive.is_rectified else {}
    recorded_T_velo = _rigid(folder / LIDAR_TO_CAMERA)
    if recorded_T_velo is None and has_lidar:
        raise LogError(f"{folder / LIDAR_TO_CAMERA}: no such file")
    camera0_T_velo = None if recorded_T_velo is None else camera0_T_recorded @ recorded_T_velo
    calibration = Calibration(projections, camera0_T_velo, _rigid(folder / IMU_TO_LIDAR))
    if drive.is_rectified:
        rig = rig_of(calibration, {i: cameras.size(f"S_rect_{i:02d}") for i in numbers}, has_lidar)
    else:
        # The cameras as they are; [R | T] moves points from recorded camera 0 to camera X.
        mounts, models = dict(rig_of(calibration, {}, has_lidar).mounts), {}
        for i in numbers:
            recorded_T_camera = inverse(cameras.transform(f"R_{i:02d}", f"T_{i:02d}"))
            mounts[camera_name(i)] = mount_of("camera", BODY_T_CAMERA0 @ camera0_T_recorded @ recorded_T_camera)
            K, size_wh = cameras.pinhole(f"K_{i:02d}", 3, 3), cameras.size(f"S_{i:02d}")
            models[camera_name(i)] = CameraModel(K, size_wh, "plumb_bob", cameras.array(f"D_{i:02d}", 5))
        rig = Rig(mounts, models)
    return DriveCalibration(rig, calibration, cameras.texts.get("calib_time", "").strip())


def _rigid(path: Path) -> Float64 | None:
    return _read(path).transform("R", "T") if path.exists() else None


def _read(path: Path) -> Numbers:
    pairs = (line.split(":", 1) for line in read_text(path, 2**20).splitlines() if ":" in line)
    return Numbers(path, {name.strip(): text for name, text in pairs})
