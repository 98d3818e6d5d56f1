"""Calibration of RADIATE's van, from the SDK's `default-calib.yaml`."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, Field, ValidationError
from scipy.spatial.transform import Rotation

from fbench.datasets.importing.files import BODY_T_OPTICAL, is_rotation, mount_of
from fbench.datasets.radiate.radar import RADAR
from fbench.replay.contracts.errors import LogError, first_wrong
from fbench.replay.data.arrays import Float64
from fbench.replay.data.rig import CameraModel, Kind, Rig
from fbench.replay.formats.documents import YamlFileError, read_yaml
from fbench.replay.geometry.transforms import inverse

FILE_NAME = "default-calib.yaml"
LIDAR, LEFT, RIGHT = "velo_lidar", "zed_left", "zed_right"
_OPTICAL_R_SENSOR: Float64 = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], np.float64)
"""(3, 3) from the LiDAR's axes, right, forward, up, to right, down, forward."""
_Number = Annotated[float, Field(gt=-1e6, lt=1e6)]
_Three = tuple[_Number, _Number, _Number]
_Pixels = Annotated[int, Field(gt=0, le=100_000)]
_Focal = Annotated[float, Field(gt=0, lt=1e6)]


class Extrinsics(BaseModel):
    """Position T [m] right, down, forward of the radar, and angles R [deg] about these axes."""

    T: _Three
    R: _Three


class Camera(Extrinsics):
    """Extrinsics, K, lens and size of a camera."""

    fx: _Focal
    fy: _Focal
    cx: _Number
    cy: _Number
    k1: _Number
    k2: _Number
    p1: _Number
    p2: _Number
    k3: _Number = 0.0
    res: tuple[_Pixels, _Pixels]


class Stereo(BaseModel):
    """Pose of the left camera in coordinates of the right one: T [mm], R as matrix."""

    TX: _Number
    TY: _Number
    TZ: _Number
    R: tuple[_Three, _Three, _Three]


class Calibration(BaseModel):
    """A file like `default-calib.yaml`; `radar_calib` stands in the SDK's `config.yaml`, where all of it is 0."""

    radar_calib: Extrinsics = Extrinsics(T=(0.0, 0.0, 0.0), R=(0.0, 0.0, 0.0))
    lidar_calib: Extrinsics
    left_cam_calib: Camera
    right_cam_calib: Camera
    stereo_calib: Stereo | None = None


def read_calibration(path: Path) -> Calibration:
    """Read a file. Raises LogError naming file and key."""
    try:
        calibration = Calibration.model_validate(read_yaml(path))
    except YamlFileError as error:
        raise LogError(f"{path}: {error}") from error
    except ValidationError as error:
        raise LogError(f"{path}: {first_wrong(error)}") from error
    stereo = calibration.stereo_calib
    if stereo is not None and not is_rotation(np.array(stereo.R)):
        raise LogError(f"{path}: stereo_calib.R isn't a rotation, its columns must be orthonormal within 1e-3")
    return calibration


def rig_of(calibration: Calibration, sensors: tuple[str, ...], right_camera: Literal["stereo", "own"]) -> Rig:
    """Return those sensors of the van; the body is the radar, turned to x forward, y left, z up.

    The SDK (`utils/calibration.py`) gives each pair of sensors a pose of its own, from the differences of their
    positions and angles. These can't all hold at once where angles are large; here, LiDAR to radar and LiDAR to camera
    do exactly, and radar to camera, of 1 degree and 0.5 m, within 2 cm.
    """
    lidar = calibration.lidar_calib
    body_T_lidar = BODY_T_OPTICAL @ _optical_T_sensor(lidar, calibration.radar_calib)
    body_T, cameras = {RADAR: np.eye(4), LIDAR: body_T_lidar}, {}
    for name, camera in ((LEFT, calibration.left_cam_calib), (RIGHT, calibration.right_cam_calib)):
        body_T[name] = body_T_lidar @ inverse(_optical_T_sensor(lidar, camera))
        if name in sensors:
            K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
            lens = np.array([camera.k1, camera.k2, camera.p1, camera.p2, camera.k3])
            cameras[name] = CameraModel(K, camera.res, "plumb_bob", lens)
    if right_camera == "stereo" and calibration.stereo_calib is not None:
        stereo, right_T_left = calibration.stereo_calib, np.eye(4)
        # The nearest rotation: the file gives a matrix of rounded numbers.
        right_T_left[:3, :3] = Rotation.from_matrix(np.array(stereo.R)).as_matrix()
        right_T_left[:3, 3] = np.array([stereo.TX, stereo.TY, stereo.TZ]) * 1e-3  # mm
        body_T[RIGHT] = body_T[LEFT] @ inverse(right_T_left)
    kinds: dict[str, Kind] = {RADAR: "radar", LIDAR: "lidar"}
    return Rig({name: mount_of(kinds.get(name, "camera"), body_T[name]) for name in sensors}, cameras)


def _optical_T_sensor(sensor: Extrinsics, optical: Extrinsics) -> Float64:
    """Pose (4, 4) of a sensor whose axes are right, forward, up in one whose axes are right, down, forward.

    Turns by minus the difference of angles about x, then y, then z of the latter: what the SDK's `transform` comes to.
    """
    angles_deg = np.array(optical.R) - np.array(sensor.R)
    result = np.eye(4)
    turn: Float64 = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    result[:3, :3] = turn @ _OPTICAL_R_SENSOR
    result[:3, 3] = np.array(sensor.T) - np.array(optical.T)
    return result
