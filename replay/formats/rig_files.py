"""Calibration files: fbench's own TOML, camera_info YAML, and camchains of Kalibr; opening of any form.

Keys after http://wiki.ros.org/camera_calibration_parsers. `rectification_matrix` and `projection_matrix` are those of
rectified images; fbench uses images as they are, so it takes only `camera_matrix` and the distortion. In Kalibr
`T_cn_cnm1` moves points from the camera before to this one, `T_cam_imu` from the IMU to this camera.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fbench.replay.contracts.errors import ConfigError, did_you_mean
from fbench.replay.data.arrays import Float64
from fbench.replay.data.rig import CameraModel
from fbench.replay.formats import calibration_values as values
from fbench.replay.formats.calibration_values import INVALID, MALFORMED, format_value
from fbench.replay.formats.documents import TomlError, YamlFileError, parse_toml, parse_yaml
from fbench.replay.formats.urdf import read_urdf
from fbench.replay.geometry.transforms import inverse, pose_matrix
from fbench.replay.logs.coordinate_frames import BODY, Edge
from fbench.replay.logs.rig_patch import RigPatch

Name = Annotated[str, Field(min_length=1, max_length=200)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Three = Annotated[list[Number], Field(min_length=3, max_length=3)]
Four = Annotated[list[Number], Field(min_length=4, max_length=4)]
Rows = list[list[Number]]
Pixels = Annotated[int, Field(gt=0, le=1_000_000)]
_ROTATIONS = ("rotation_xyzw", "yaw_pitch_roll_deg", "matrix")
_MIN_NORM = 1e-6  # Of a quaternion
_PINHOLE = ("fx", "fy", "cx", "cy")
IMU = "imu"  # What the coordinate frame of the IMU is called here
_MAX_DIFFERENCE = 0.01  # [m] and, of matrix elements, nearly [rad]: how far two ways to a camera may lead apart
MAX_TEXT = 1024 * 1024  # Bytes of a TOML or YAML file; a rig of a hundred sensors has a tenth of it
MAX_XML = 16 * 1024 * 1024  # Bytes of a URDF file
_FORMS = "fbench's TOML ([sensors.NAME] ...), URDF, a Kalibr camchain, or camera_info YAML of ROS"
_IMU_KEYS = ("imu", "accelerometer_noise_density", "gyroscope_noise_density")


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class PoseTable(_Strict):
    """`[sensors.NAME]` and `[frames.NAME]`: the pose of a sensor or coordinate frame in its parent's."""

    parent: Name = BODY
    translation_m: Three | None = None
    rotation_xyzw: Four | None = None
    yaw_pitch_roll_deg: Three | None = None  # R = Rz(yaw) Ry(pitch) Rx(roll)
    matrix: Rows | None = None  # `parent_T_sensor`, 4x4 or 3x4, translation included


class CameraTable(_Strict):
    """`[cameras.NAME]`: intrinsics."""

    K: Rows | None = None
    fx: Number | None = None
    fy: Number | None = None
    cx: Number | None = None
    cy: Number | None = None
    size_wh: Annotated[list[Pixels], Field(min_length=2, max_length=2)]
    distortion_model: Annotated[str, Field(max_length=200)] = ""
    distortion: Annotated[list[Number], Field(max_length=100)] = []


class RigFile(_Strict):
    """A whole file."""

    sensors: dict[Name, PoseTable] = {}
    frames: dict[Name, PoseTable] = {}  # Coordinate frames that are no sensors
    cameras: dict[Name, CameraTable] = {}


def read_rig_toml(path: Path, content: bytes) -> RigPatch:
    """Return the poses and intrinsics of a file. Raises ConfigError naming the key that is wrong or unknown."""
    try:
        file = RigFile.model_validate(parse_toml(content))
    except ValidationError as error:
        raise ConfigError(f"{path}: {_describe_first(error)}", MALFORMED) from None
    except TomlError as error:
        raise ConfigError(f"{path}: isn't TOML ({error})", MALFORMED) from error
    twice = sorted(file.sensors.keys() & file.frames.keys())
    if twice:
        raise ConfigError(f"{path}: '{twice[0]}' is in [sensors] and in [frames]; remove one", MALFORMED)
    groups = (("sensors", file.sensors), ("frames", file.frames))
    edges = {name: _edge(f"{path}: {group}.{name}", table) for group, own in groups for name, table in own.items()}
    if BODY in edges:
        raise ConfigError(f"{path}: '{BODY}' is the root, and has no pose", INVALID)
    values.require_tree(str(path), edges)
    return RigPatch(edges, {name: _camera(f"{path}: cameras.{name}", t) for name, t in file.cameras.items()})


def _describe_first(error: ValidationError) -> str:
    """What is wrong first, with the name that may be meant."""
    first = error.errors(include_url=False)[0]
    place = [str(part) for part in first["loc"]]
    if first["type"] != "extra_forbidden":
        return f"{'.'.join(place)}: {first['msg']}, got {format_value(first['input'])}"
    tables: dict[str, type[BaseModel]] = {"sensors": PoseTable, "frames": PoseTable, "cameras": CameraTable}
    table = RigFile if len(place) == 1 else tables[place[0]]
    return f"unknown key '{'.'.join(place)}'{did_you_mean(place[-1], table.model_fields)}"


def _edge(where: str, table: PoseTable) -> Edge:
    from scipy.spatial.transform import Rotation  # takes a while to import

    given = [name for name in _ROTATIONS if getattr(table, name) is not None]
    if len(given) != 1:
        what = " and ".join(given) if given else "none"
        raise ConfigError(f"{where}: expected one of {', '.join(_ROTATIONS)}; got {what}", MALFORMED)
    if table.matrix is not None:
        if table.translation_m is not None:
            raise ConfigError(f"{where}: a matrix holds the translation, so translation_m is one too many", MALFORMED)
        place = f"{where}.matrix"
        return Edge(table.parent, *values.rigid(place, values.matrix(place, table.matrix, (4, 4), (3, 4))))
    if table.translation_m is None:
        raise ConfigError(f"{where}: no translation_m", MALFORMED)
    if table.rotation_xyzw is not None:
        if math.hypot(*table.rotation_xyzw) < _MIN_NORM:
            raise ConfigError(f"{where}.rotation_xyzw: is zero, so no rotation", INVALID)
        rotation = np.array(table.rotation_xyzw, np.float64)
    else:
        angles: Any = table.yaw_pitch_roll_deg
        rotation = np.asarray(Rotation.from_euler("ZYX", angles, degrees=True).as_quat(), np.float64)
    return Edge(table.parent, np.array(table.translation_m, np.float64), rotation)


def _camera(where: str, table: CameraTable) -> CameraModel:
    given = [name for name in _PINHOLE if getattr(table, name) is not None]
    if (table.K is None) == (not given) or len(given) not in (0, len(_PINHOLE)):
        got = [*(["K"] if table.K is not None else []), *given]
        raise ConfigError(f"{where}: expected K, or fx, fy, cx and cy; got {', '.join(got) or 'none'}", MALFORMED)
    if table.K is not None:
        K = values.matrix(f"{where}.K", table.K, (3, 3))
    else:
        fx, fy, cx, cy = (getattr(table, name) for name in _PINHOLE)
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
    width, height = table.size_wh
    return values.camera_model(where, K, (width, height), table.distortion_model, table.distortion)


def read_camera_info(path: Path, tree: Mapping[str, object]) -> RigPatch:
    """Return the camera of a file, under its `camera_name`, else the file's name. ConfigError names the wrong key."""
    if missing := [key for key in ("image_width", "image_height") if key not in tree]:
        raise ConfigError(f"{path}: no '{missing[0]}'", MALFORMED)
    width, height = (values.natural(f"{path}: {key}", tree[key]) for key in ("image_width", "image_height"))
    K = np.array(_data(path, tree, "camera_matrix", 3, 3)).reshape(3, 3)
    distortion = _data(path, tree, "distortion_coefficients", 1) if "distortion_coefficients" in tree else []
    model = values.require_model(f"{path}: distortion_model", _text(path, tree, "distortion_model", "plumb_bob"))
    name = _text(path, tree, "camera_name", path.stem) or path.stem
    return RigPatch(cameras={name: values.camera_model(f"{path}: {name}", K, (width, height), model, distortion)})


def _text(path: Path, tree: Mapping[str, object], key: str, default: str) -> str:
    value = tree.get(key, default)
    if not isinstance(value, str):
        raise ConfigError(f"{path}: {key}: expected a text, got {format_value(value)}", MALFORMED)
    return value.strip()


def _data(path: Path, tree: Mapping[str, object], key: str, rows: int, cols: int | None = None) -> list[float]:
    """Return the numbers of `{rows, cols, data}`, row by row."""
    value = tree.get(key)
    if not isinstance(value, Mapping) or "data" not in value:
        raise ConfigError(f"{path}: no '{key}' with rows, cols and data", MALFORMED)
    named = [n for n in ("rows", "cols") if n in value and value[n] != "0"]
    found = tuple(values.natural(f"{path}: {key}.{n}", value[n]) for n in named)
    data = values.numbers(f"{path}: {key}.data", value["data"], None if cols is None else rows * cols)
    if len(found) == 2 and found != (rows, len(data) // rows):
        shapes = f"expected {rows}x{len(data) // rows}, got {found[0]}x{found[1]} (rows x cols)"
        raise ConfigError(f"{path}: {key}: {shapes}", MALFORMED)
    return data


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
            topics[name] = _text_of(where, camera, "rostopic")
        chained = _pose(where, camera, "T_cn_cnm1") if num else None
        by_imu = _pose(where, camera, "T_cam_imu")
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
    projection = _text_of(where, camera, "camera_model")
    if projection != "pinhole":
        raise ConfigError(f"{where}.camera_model: '{projection}' isn't supported; there is: pinhole", INVALID)
    fu, fv, pu, pv = values.numbers(f"{where}.intrinsics", _value(where, camera, "intrinsics"), 4)
    size = _value(where, camera, "resolution")
    if not isinstance(size, list) or len(size) != 2:
        raise ConfigError(f"{where}.resolution: expected width and height, got {values.format_value(size)}", MALFORMED)
    width, height = (values.natural(f"{where}.resolution[{i}]", value) for i, value in enumerate(size))
    model = values.require_model(f"{where}.distortion_model", _text_of(where, camera, "distortion_model"))
    distortion = values.numbers(f"{where}.distortion_coeffs", camera.get("distortion_coeffs", []))
    if model != "none" and len(distortion) != 4:
        raise ConfigError(f"{where}.distortion_coeffs: expected 4 numbers, got {len(distortion)}", MALFORMED)
    K = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1]], np.float64)
    return values.camera_model(f"{where}.intrinsics", K, (width, height), model, [] if model == "none" else distortion)


def _pose(where: str, camera: Mapping[str, object], key: str) -> Float64 | None:
    """The matrix (4, 4) of a key; `None` without it."""
    if key not in camera:
        return None
    place = f"{where}.{key}"
    return pose_matrix(*values.rigid(place, values.matrix(place, camera[key], (4, 4))))


def _value(where: str, camera: Mapping[str, object], key: str) -> object:
    if key not in camera:
        raise ConfigError(f"{where}: no '{key}'", MALFORMED)
    return camera[key]


def _text_of(where: str, camera: Mapping[str, object], key: str) -> str:
    value = _value(where, camera, key)
    if not isinstance(value, str):
        raise ConfigError(f"{where}.{key}: expected a text, got {values.format_value(value)}", MALFORMED)
    return value


def open_rig_file(path: Path) -> RigPatch:
    """Read calibration; the form is told by the content: our TOML, URDF, Kalibr camchain, or ROS camera_info YAML.
    Raises ConfigError naming the file, and the key that is wrong.
    """
    if path.exists() and not path.is_file():  # a FIFO would block, a device could go on for ever
        raise ConfigError(f"{path}: not a regular file; name the file with the calibration")
    try:
        with path.open("rb") as file:
            content = file.read(MAX_XML + 1)
    except OSError as error:
        raise ConfigError(f"{path}: can't be read ({error.strerror})") from error
    start = content.removeprefix(b"\xef\xbb\xbf").lstrip()
    is_xml = path.suffix.lower() == ".xacro" or start.startswith(b"<")
    if len(content) > (limit := MAX_XML if is_xml or len(content) > MAX_XML else MAX_TEXT):
        raise ConfigError(f"{path}: has more than {limit} bytes, too large for a calibration", MALFORMED)
    if is_xml:
        patch = read_urdf(path, content)
    elif _is_toml(path, start):
        patch = read_rig_toml(path, content)
    else:
        patch = _yaml(path, content)
    origins = dict.fromkeys([*patch.edges, *patch.cameras, *patch.topics, *patch.moving], str(path))
    return RigPatch(patch.edges, patch.cameras, patch.topics, origins, patch.moving)


def _is_toml(path: Path, start: bytes) -> bool:
    """TOML begins with a table or `key =`, which none of the YAML forms does."""
    if path.suffix.lower() == ".toml":
        return True
    lines = (line.strip() for line in start.splitlines())
    first = next((line for line in lines if line and not line.startswith(b"#")), b"")
    return first.startswith(b"[") or b"=" in first.partition(b":")[0]


def _yaml(path: Path, content: bytes) -> RigPatch:
    if content.lstrip().startswith(b"%YAML:"):
        raise ConfigError(f"{path}: an OpenCV FileStorage isn't read; expected {_FORMS}", MALFORMED)
    try:
        tree = parse_yaml(content)
    except YamlFileError as error:
        raise ConfigError(f"{path}: {error}", MALFORMED) from error
    keys = [key for key in tree if isinstance(key, str)] if isinstance(tree, dict) else []
    if isinstance(tree, dict) and ("camera_matrix" in keys or "image_width" in keys):
        return read_camera_info(path, tree)
    if isinstance(tree, dict) and any(_is_numbered(key, "cam") for key in keys):
        return read_kalibr(path, tree)
    if any(key in _IMU_KEYS or _is_numbered(key, "imu") for key in keys):
        raise ConfigError(f"{path}: is about an IMU, and holds no camera; name the camchain of Kalibr", MALFORMED)
    raise ConfigError(f"{path}: no calibration that is known; expected {_FORMS}", MALFORMED)


def _is_numbered(key: str, name: str) -> bool:
    digits = key.removeprefix(name)
    return key.startswith(name) and digits.isascii() and digits.isdecimal()
