"""Camchains of Kalibr (YAML), read by its own names: `T_cn_cnm1` moves points from the camera before to this one,
`T_cam_imu` from the IMU to this camera.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.rig import CameraModel
from fbench.replay.formats import calibration_values as values
from fbench.replay.formats.calibration_values import INVALID, MALFORMED
from fbench.replay.geometry.transforms import inverse, pose_matrix
from fbench.replay.logs.coordinate_frames import Edge
from fbench.replay.logs.rig_patch import RigPatch

IMU = "imu"  # What the coordinate frame of the IMU is called here
_MAX_DIFFERENCE = 0.01  # [m] and, of matrix elements, nearly [rad]: how far two ways to a camera may lead apart


def read_kalibr(path: Path, tree: Mapping[str, object]) -> RigPatch:
    """Return cameras `cam0`, `cam1` ... with their topics: each in the IMU's coordinate frame where the file has it,
    else in that of the camera before. Raises ConfigError naming the key that is wrong.
    """
    cameras: dict[str, CameraModel] = {}
    edges: dict[str, Edge] = {}
    topics: dict[str, str] = {}
    before: Float64 | None = None
    for num, (name, camera) in enumerate(_sort_by_number(path, tree)):
        where = f"{path}: {name}"
        cameras[name] = _intrinsics(where, camera)
        if "rostopic" in camera:
            topics[name] = _text(where, camera, "rostopic")
        chained = _transform(where, camera, "T_cn_cnm1") if num else None
        by_imu = _transform(where, camera, "T_cam_imu")
        if by_imu is not None:
            apart = 0.0 if chained is None or before is None else float(np.abs(chained @ before - by_imu).max())
            if not apart <= _MAX_DIFFERENCE:
                ways = f"'T_cn_cnm1' and 'T_cam_imu' lead to poses that differ by {apart:.3g}"
                raise ConfigError(f"{where}: {ways}; remove one", INVALID)
            edges[name] = Edge(IMU, *values.rigid(where, inverse(by_imu)))
        elif chained is not None:
            edges[name] = Edge(f"cam{num - 1}", *values.rigid(where, inverse(chained)))
        elif num:
            raise ConfigError(f"{where}: no 'T_cn_cnm1' and no 'T_cam_imu', so it isn't linked", MALFORMED)
        before = by_imu
    return RigPatch(edges, cameras, topics)


def _sort_by_number(path: Path, tree: Mapping[str, object]) -> list[tuple[str, Mapping[str, object]]]:
    """The cameras, in order."""
    names = [name for name in tree if name.startswith("cam") and name[3:].isdecimal()]
    found: list[tuple[str, Mapping[str, object]]] = []
    for num in range(len(names)):
        camera = tree.get(f"cam{num}")
        if not isinstance(camera, Mapping):
            raise ConfigError(f"{path}: no 'cam{num}', though there are {len(names)} cameras", MALFORMED)
        found.append((f"cam{num}", camera))
    return found


def _intrinsics(where: str, camera: Mapping[str, object]) -> CameraModel:
    projection = _text(where, camera, "camera_model")
    if projection != "pinhole":
        raise ConfigError(f"{where}.camera_model: '{projection}' isn't supported; there is: pinhole", INVALID)
    fu, fv, pu, pv = values.numbers(f"{where}.intrinsics", _value(where, camera, "intrinsics"), 4)
    size = _value(where, camera, "resolution")
    if not isinstance(size, list) or len(size) != 2:
        raise ConfigError(f"{where}.resolution: expected width and height, got {values.format_value(size)}", MALFORMED)
    width, height = (values.natural(f"{where}.resolution[{i}]", value) for i, value in enumerate(size))
    model = values.require_model(f"{where}.distortion_model", _text(where, camera, "distortion_model"))
    distortion = values.numbers(f"{where}.distortion_coeffs", camera.get("distortion_coeffs", []))
    if model != "none" and len(distortion) != 4:
        raise ConfigError(f"{where}.distortion_coeffs: expected 4 numbers, got {len(distortion)}", MALFORMED)
    K = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1]], np.float64)
    return values.camera_model(f"{where}.intrinsics", K, (width, height), model, [] if model == "none" else distortion)


def _transform(where: str, camera: Mapping[str, object], key: str) -> Float64 | None:
    """The matrix (4, 4) of a key; `None` without it."""
    if key not in camera:
        return None
    place = f"{where}.{key}"
    return pose_matrix(*values.rigid(place, values.matrix(place, camera[key], (4, 4))))


def _value(where: str, camera: Mapping[str, object], key: str) -> object:
    if key not in camera:
        raise ConfigError(f"{where}: no '{key}'", MALFORMED)
    return camera[key]


def _text(where: str, camera: Mapping[str, object], key: str) -> str:
    value = _value(where, camera, key)
    if not isinstance(value, str):
        raise ConfigError(f"{where}.{key}: expected a text, got {values.format_value(value)}", MALFORMED)
    return value
