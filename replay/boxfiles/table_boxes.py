"""Rows of a table as boxes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fbench.replay.arrays import Array, Bool, Float64
from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.boxfiles.placing import camera_of
from fbench.replay.boxfiles.rotations import angles
from fbench.replay.boxfiles.table_files import TableFile
from fbench.replay.boxfiles.table_values import Values
from fbench.replay.classes import label
from fbench.replay.errors import LogError
from fbench.replay.logs.coordinates import CoordinateFrames
from fbench.replay.names import did_you_mean

SOLID = ("x", "y", "z", "length", "width", "height")
FLAT = ("left", "top", "right", "bottom")
_QUATERNION = ("qx", "qy", "qz", "qw")
_VELOCITY = ("vx", "vy", "vz")
_ANGLES = ("yaw", "pitch", "roll")
_FLOATS = ("score", "visibility", "occlusion", "truncation")
_FLAT_FLOATS = ("distance_m", "range_rate_mps")
_WHOLES = ("num_lidar_pts", "num_radar_pts")
COLUMNS = (
    "stamp_ns", "stamp_s", "frame", "frame_id", *SOLID, *_ANGLES, "yaw_deg", *_QUATERNION, *_VELOCITY, "camera", *FLAT,
    "label", *_FLOATS, "track_id", "ignore", "attribute", *_WHOLES, *_FLAT_FLOATS, "arrival_ns",
)  # fmt: skip


@dataclass(frozen=True)
class Spaces:
    """Which kinds of boxes a table has columns for."""

    solid: bool
    flat: bool


@dataclass(frozen=True, eq=False)
class Rows:
    """Which of N rows have a box, and these boxes."""

    has_solid: Bool
    solids: Boxes3D
    """(sum of `has_solid`), each in its own coordinate frame."""
    frames: Array
    """Names of these."""
    has_flat: Bool
    flats: Boxes2D


def spaces_of(file: TableFile) -> Spaces:
    """Tell what a table's columns can hold.

    Raises:
        LogError: naming the column that is missing, or that is probably another one's name.
    """
    names = file.names
    found = Spaces(any(name in names for name in SOLID), any(name in names for name in FLAT))
    if not (found.solid or found.flat):
        raise LogError(f"{file.path}: no columns of boxes; expected {' '.join(SOLID)} yaw, or {' '.join(FLAT)}")
    for is_there, needed in ((found.solid, SOLID), (found.flat, FLAT)):
        missing = next((name for name in needed if is_there and name not in names), None)
        if missing is not None:
            raise LogError(f"{file.path}: column '{missing}' is missing{_near(missing, names)}")
    if found.solid and not ({"yaw", "yaw_deg"} & set(names) or set(_QUATERNION) <= set(names)):
        raise LogError(f"{file.path}: column 'yaw' is missing (or yaw_deg, or qx qy qz qw)")
    for name in names:
        near = did_you_mean(name, COLUMNS) if name not in COLUMNS and len(name) > 4 else ""
        meant = near.partition("did you mean '")[2].rstrip("?").rstrip("'")
        if meant and meant not in names and _is_slip(name, meant):
            raise LogError(f"{file.path}: column '{name}' isn't known{near}")
    return found


def rows_of(values: Values, spaces: Spaces, camera: str, coordinates: CoordinateFrames) -> Rows:
    """Read boxes.

    Args:
        values: Rows of the table.
        spaces: What its columns hold.
        camera: Whose image 2D boxes are in, where the table doesn't say.
        coordinates: What names mean.

    Raises:
        ConfigError: where a camera isn't known.
        LogError: naming row and column of what can't be read.
    """
    nothing = np.zeros(len(values), bool)
    has_solid = _there(values, SOLID) if spaces.solid else nothing
    has_flat = _there(values, FLAT) if spaces.flat else nothing
    common = _common(values)
    frames = values.texts("frame_id") if "frame_id" in values else np.full(len(values), "")
    return Rows(
        has_solid,
        _solids(values, has_solid, common) if has_solid.any() else Boxes3D.empty(),
        frames[has_solid],
        has_flat,
        _flats(values, has_flat, common, camera, coordinates) if has_flat.any() else Boxes2D.empty(),
    )


def _there(values: Values, names: Sequence[str]) -> Bool:
    """Tell which rows have a box; one that has only a part of it is refused, one of NaN alone has none."""
    read = [values.numbers(name) for name in names]
    numbers = np.stack([numbers for numbers, _ in read], axis=1)
    told: Bool = np.stack([there for _, there in read], axis=1) & ~np.isnan(numbers).all(axis=1, keepdims=True)
    there: Bool = np.all(told, axis=1)
    partly: Bool = np.any(told, axis=1) & ~there
    if partly.any():
        row = int(np.argmax(partly))
        raise LogError(f"{values.where(row)}: {names[int(np.argmin(told[row]))]} is empty, though the row has a box")
    return there


def _stacked(values: Values, names: Sequence[str], rows: Bool) -> Float64:
    return np.stack([values.numbers(name)[0][rows] for name in names], axis=1)


def _solids(values: Values, rows: Bool, common: dict[str, Array]) -> Boxes3D:
    box = _stacked(values, SOLID, rows)
    turn = _turned(values, rows)
    upright = not np.any(turn[:, 1:])
    velocity = None
    if "vx" in values and "vy" in values:
        velocity = _stacked(values, _VELOCITY if "vz" in values else _VELOCITY[:2], rows)
        unknown = np.isnan(velocity[:, :2]).any(axis=1)
        velocity = np.pad(velocity, ((0, 0), (0, 3 - velocity.shape[1])))
        velocity[:, 2] = np.where(np.isnan(velocity[:, 2]), 0.0, velocity[:, 2])
        velocity[unknown] = np.nan
    chosen: dict[str, Any] = {name: column[rows] for name, column in common.items()}
    return Boxes3D(
        box[:, :3], box[:, 3:], turn[:, 0], pitch_rad=None if upright else turn[:, 1],
        roll_rad=None if upright else turn[:, 2], velocity_mps=velocity, **chosen,
    )  # fmt: skip


def _turned(values: Values, rows: Bool) -> Float64:
    """Yaw, pitch, roll (N, 3)."""
    if all(name in values for name in _QUATERNION):
        at = np.flatnonzero(rows)
        quaternions = _stacked(values, _QUATERNION, rows)
        return np.array(
            [angles(x, y, z, w, values.where(int(i))) for (x, y, z, w), i in zip(quaternions.tolist(), at, strict=True)]
        )
    turn = np.zeros((int(rows.sum()), 3))
    for i, name in enumerate(_ANGLES):
        column = "yaw_deg" if name == "yaw" and "yaw" not in values else name
        if column in values:
            numbers, there = values.numbers(column)
            turn[:, i] = np.where(there, np.deg2rad(numbers) if column == "yaw_deg" else numbers, 0.0)[rows]
            if name == "yaw" and not there[rows].all():
                row = int(np.argmax(rows & ~there))
                raise LogError(f"{values.where(row)}: {column} is empty, though the row has a box")
    return turn


def _flats(values: Values, rows: Bool, common: dict[str, Array], camera: str, coordinates: CoordinateFrames) -> Boxes2D:
    named = values.texts("camera")[rows] if "camera" in values else np.full(int(rows.sum()), "")
    at = values.where(int(np.argmax(rows)))
    known = {name: camera_of(str(name) or camera, coordinates, at) for name in np.unique(named)}
    chosen: dict[str, Any] = {name: column[rows] for name, column in common.items()}
    chosen |= {name: values.numbers(name)[0][rows] for name in _FLAT_FLOATS if name in values}
    cameras = np.array([known[name] for name in named], np.str_)
    return Boxes2D(cameras, _stacked(values, FLAT, rows), **chosen)


def _common(values: Values) -> dict[str, Array]:
    columns: dict[str, Array] = {name: values.numbers(name)[0] for name in _FLOATS if name in values}
    columns |= {name: values.wholes(name) for name in _WHOLES if name in values}
    if "label" in values:
        names = values.texts("label")
        known = {name: label(str(name)) for name in np.unique(names)}
        columns["label"] = np.array([known[name] for name in names], np.str_)
        columns["source_label"] = names
    if "track_id" in values:
        columns["track_id"] = values.ids("track_id")
    if "ignore" in values:
        columns["ignore"] = values.flags("ignore")
    if "attribute" in values:
        columns["attribute"] = values.texts("attribute")
    return columns


def _near(missing: str, names: dict[str, str]) -> str:
    hint = did_you_mean(missing, [name for name in names if name not in COLUMNS])
    return hint if "did you mean" in hint else f"; there are: {', '.join(names)}"


def _is_slip(name: str, meant: str) -> bool:
    """Whether the names differ in dashes, blanks or one letter at most."""
    plain = [text.replace("_", "").replace("-", "").replace(" ", "") for text in (name, meant)]
    return plain[0] == plain[1] or (abs(len(name) - len(meant)) <= 1 and sorted(name)[:-1] == sorted(meant)[:-1])
