"""Sensors of KITTI's car, from the numbers of its calibration files.

A. Geiger, P. Lenz, C. Stiller and R. Urtasun, "Vision meets Robotics: The KITTI Dataset", IJRR 2013, section IV.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fbench.replay.data import CameraModel, Float64, Rig
from fbench.replay.geometry.transforms import inverse
from fbench.replay.imports.rigs import BODY_T_OPTICAL, mount_of

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
