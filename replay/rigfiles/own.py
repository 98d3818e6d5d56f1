"""Our own form of calibration: TOML, for people to write. docs/logs.md describes it."""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy.spatial.transform import Rotation

from fbench.replay.arrays import Float64
from fbench.replay.data import CameraModel
from fbench.replay.errors import ConfigError
from fbench.replay.logs.tree import BODY, Edge
from fbench.replay.names import did_you_mean
from fbench.replay.rig_patch import RigPatch
from fbench.replay.rigfiles.values import (
    INVALID,
    MALFORMED,
    camera_model,
    matrix,
    require_tree,
    rigid,
    shown,
    unit_quaternion,
)
from fbench.replay.toml_file import TomlError, parse_toml

Name = Annotated[str, Field(min_length=1, max_length=200)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Three = Annotated[list[Number], Field(min_length=3, max_length=3)]
Four = Annotated[list[Number], Field(min_length=4, max_length=4)]
Rows = list[list[Number]]
Pixels = Annotated[int, Field(gt=0, le=1_000_000)]
_ROTATIONS = ("rotation_xyzw", "yaw_pitch_roll_deg", "matrix")
_PINHOLE = ("fx", "fy", "cx", "cy")


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class PoseTable(_Strict):
    """`[sensors.NAME]` and `[frames.NAME]`: the pose of a sensor or coordinate frame in its parent's."""

    parent: Name = BODY
    translation_m: Three | None = None
    rotation_xyzw: Four | None = None
    yaw_pitch_roll_deg: Three | None = None
    """R = Rz(yaw) Ry(pitch) Rx(roll)."""
    matrix: Rows | None = None
    """`parent_T_sensor`, 4x4 or 3x4, translation included."""


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
    frames: dict[Name, PoseTable] = {}
    """Coordinate frames that are no sensors."""
    cameras: dict[Name, CameraTable] = {}


def read_own(path: Path, content: bytes) -> RigPatch:
    """Return the poses and intrinsics of a file.

    Raises:
        ConfigError: naming the key that is wrong or unknown.
    """
    file = _parsed(path, content)
    twice = sorted(file.sensors.keys() & file.frames.keys())
    if twice:
        raise ConfigError(f"{path}: '{twice[0]}' is in [sensors] and in [frames]; remove one", MALFORMED)
    edges = {name: _edge(f"{path}: sensors.{name}", table) for name, table in file.sensors.items()}
    edges |= {name: _edge(f"{path}: frames.{name}", table) for name, table in file.frames.items()}
    if BODY in edges:
        raise ConfigError(f"{path}: '{BODY}' is the root, and has no pose", INVALID)
    require_tree(str(path), edges)
    return RigPatch(edges, {name: _camera(f"{path}: cameras.{name}", t) for name, t in file.cameras.items()})


def _parsed(path: Path, content: bytes) -> RigFile:
    try:
        return RigFile.model_validate(parse_toml(content))
    except ValidationError as error:
        raise ConfigError(f"{path}: {_first(error)}", MALFORMED) from None
    except TomlError as error:
        raise ConfigError(f"{path}: isn't TOML ({error})", MALFORMED) from error


def _first(error: ValidationError) -> str:
    """What is wrong first, with the name that may be meant."""
    first = error.errors(include_url=False)[0]
    place = [str(part) for part in first["loc"]]
    if first["type"] != "extra_forbidden":
        return f"{'.'.join(place)}: {first['msg']}, got {shown(first['input'])}"
    tables: dict[str, type[BaseModel]] = {"sensors": PoseTable, "frames": PoseTable, "cameras": CameraTable}
    table = RigFile if len(place) == 1 else tables[place[0]]
    return f"unknown key '{'.'.join(place)}'{did_you_mean(place[-1], table.model_fields)}"


def _edge(where: str, table: PoseTable) -> Edge:
    given = [name for name in _ROTATIONS if getattr(table, name) is not None]
    if len(given) != 1:
        what = " and ".join(given) if given else "none"
        raise ConfigError(f"{where}: expected one of {', '.join(_ROTATIONS)}; got {what}", MALFORMED)
    if table.matrix is not None:
        if table.translation_m is not None:
            raise ConfigError(f"{where}: a matrix holds the translation, so translation_m is one too many", MALFORMED)
        place = f"{where}.matrix"
        return Edge(table.parent, *rigid(place, matrix(place, table.matrix, (4, 4), (3, 4))))
    if table.translation_m is None:
        raise ConfigError(f"{where}: no translation_m", MALFORMED)
    return Edge(table.parent, np.array(table.translation_m, np.float64), _rotation(where, table))


def _rotation(where: str, table: PoseTable) -> Float64:
    if table.rotation_xyzw is not None:
        return unit_quaternion(f"{where}.rotation_xyzw", table.rotation_xyzw)
    angles: Any = table.yaw_pitch_roll_deg
    return np.asarray(Rotation.from_euler("ZYX", angles, degrees=True).as_quat(), np.float64)


def _camera(where: str, table: CameraTable) -> CameraModel:
    given = [name for name in _PINHOLE if getattr(table, name) is not None]
    if (table.K is None) == (not given) or len(given) not in (0, len(_PINHOLE)):
        got = [*(["K"] if table.K is not None else []), *given]
        raise ConfigError(f"{where}: expected K, or fx, fy, cx and cy; got {', '.join(got) or 'none'}", MALFORMED)
    if table.K is not None:
        K = matrix(f"{where}.K", table.K, (3, 3))
    else:
        fx, fy, cx, cy = (getattr(table, name) for name in _PINHOLE)
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
    width, height = table.size_wh
    return camera_model(where, K, (width, height), table.distortion_model, table.distortion)
