"""Sensors of KITTI's car from its calibration files, and the sizes of its images.

A. Geiger, P. Lenz, C. Stiller and R. Urtasun, "Vision meets Robotics: The KITTI Dataset", IJRR 2013, section IV.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fbench.datasets.importing.files import read_bytes
from fbench.datasets.importing.summary import BODY_T_OPTICAL, mount_of
from fbench.replay.contracts.errors import DecodeError, LogError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.images import encoded_size
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.formats.objects import Labelled
from fbench.replay.geometry.transforms import inverse

LIDAR = "velodyne"
BODY_T_CAMERA0 = BODY_T_OPTICAL
"""(4, 4) from the rectified camera 0 (x right, y down, z forward) to the body.

Body coordinates have their origin in the rectified camera 0, so that labels, which are given there and stand upright
there, are the same boxes in the log, whatever the calibration of the other sensors.
"""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What KITTI's calibration files say; coordinates of camera 0 are the rectified ones."""

    projections: Mapping[int, Float64]
    """P (3, 4) of the rectified cameras by number, from rectified camera 0 to pixels."""
    camera0_T_velo: Float64 | None = None
    """(4, 4), rectification included."""
    velo_T_imu: Float64 | None = None
    """(4, 4)."""

    @property
    def body_T_imu(self) -> Float64 | None:
        """(4, 4) where the calibration tells it."""
        if self.camera0_T_velo is None or self.velo_T_imu is None:
            return None
        return BODY_T_CAMERA0 @ self.camera0_T_velo @ self.velo_T_imu


def camera_name(number: int) -> str:
    """Name of a camera: that of its folder."""
    return f"image_{number:02d}"


def rig_of(calibration: Calibration, sizes_wh: Mapping[int, tuple[int, int]], has_lidar: bool) -> Rig:
    """Return the sensors: the rectified cameras whose sizes [px] are given, and the LiDAR where there is one.

    P = K [I | t] gives the camera's position -t in rectified camera 0 (paper, equation 4).

    Raises:
        KeyError: for a camera without P.
        ValueError: where `has_lidar` and the calibration doesn't tell where it is.
    """
    mounts, cameras = {}, {}
    for number, size_wh in sorted(sizes_wh.items()):
        P = calibration.projections[number]
        K = P[:, :3]
        camera0_T_camera = np.eye(4)
        camera0_T_camera[:3, 3] = -np.linalg.solve(K, P[:, 3])
        mounts[camera_name(number)] = mount_of("camera", BODY_T_CAMERA0 @ camera0_T_camera)
        cameras[camera_name(number)] = CameraModel(np.array(K), size_wh)
    if has_lidar:
        if calibration.camera0_T_velo is None:
            raise ValueError("the calibration doesn't tell where the LiDAR is")
        mounts[LIDAR] = mount_of("lidar", BODY_T_CAMERA0 @ calibration.camera0_T_velo)
    return Rig(mounts, cameras)


def world_T_body(world_T_imu: Float64, calibration: Calibration) -> Float64 | None:
    """Return the body's pose (4, 4) from that of the IMU; `None` where the calibration doesn't tell it."""
    body_T_imu = calibration.body_T_imu
    return None if body_T_imu is None else world_T_imu @ inverse(body_T_imu)


Size = tuple[int, int]
_BY_FOCAL_LENGTH: Mapping[float, tuple[str, Size]] = {
    721.5377: ("2011_09_26", (1242, 375)),
    707.0493: ("2011_09_28", (1224, 370)),
    718.3351: ("2011_09_29", (1238, 374)),
    707.0912: ("2011_09_30", (1226, 370)),
    718.856: ("2011_10_03", (1241, 376)),
}
"""Day of recording and size [px], by the focal length [px] of the rectified cameras, which is that of the day."""
_MAX_SIDE_PX = 2**16


def known_size(P: Float64) -> tuple[str, Size] | None:
    """Return the day that a projection (3, 4) belongs to, and the images' size [px] on it; `None` where it is none of
    KITTI's.
    """
    return _BY_FOCAL_LENGTH.get(round(float(P[0, 0]), 4))


def size_without_images(P: Float64, objects: Iterable[Labelled]) -> tuple[Size, str]:
    """Return a size [px] for the camera of a projection (3, 4) that there are no images of, and how it is known.

    It is that of the day; else that of the smallest image that holds all labelled boxes; without any, that of the image
    whose middle is the principal point.
    """
    known = known_size(P)
    if known is not None:
        day, size_wh = known
        return size_wh, f"without images: that of {day}, the day of recording by its focal length"
    corners = [row.flat.xyxy_px[2:] for row in objects if row.flat is not None]
    if corners:
        right, bottom = (max(values) for values in zip(*corners, strict=True))
        return _size(right + 1, bottom + 1), "without images: the smallest that holds all labelled boxes"
    return _size(2 * P[0, 2], 2 * P[1, 2]), "without images: twice the principal point"


def _size(width: float, height: float) -> Size:
    return min(max(math.ceil(width), 1), _MAX_SIDE_PX), min(max(math.ceil(height), 1), _MAX_SIDE_PX)


def first_size(paths: Iterable[Path]) -> Size | None:
    """Return the size [px] of the first image whose header can be read; `None` where there is none."""
    for path in paths:
        try:
            return encoded_size(read_bytes(path))
        except (LogError, DecodeError):
            continue  # whoever reads it for its pixels tells what is wrong with it
    return None
