"""Labeled objects as files describe them one by one, the boxes or columns that they make, and where these are."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np

from fbench.replay.contracts.errors import ConfigError, DecodeError, LimitError, LogError, did_you_mean
from fbench.replay.data.arrays import Array, Float64, text_array
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.classes import label
from fbench.replay.geometry.iou import move_boxes
from fbench.replay.logs.coordinate_frames import WORLDS, CoordinateFrames
from fbench.replay.logs.setup import BoxSource

Triple = tuple[float, float, float]
_NONE3 = (np.nan,) * 3
_NONE4 = (np.nan,) * 4
_MAX_EMPTY = 200_000  # Frames without rows, one after the other, that still belong to a sequence: nearly two hours
_OPTIONAL: dict[str, tuple[Any, Any]] = {
    "score": (np.float64, np.nan), "track_id": (np.int64, -1), "ignore": (np.bool_, False),
    "visibility": (np.float64, np.nan), "occlusion": (np.float64, np.nan), "truncation": (np.float64, np.nan),
    "alpha_rad": (np.float64, np.nan), "attribute": (np.str_, ""), "num_lidar_pts": (np.int64, -1),
}  # fmt: skip
"""Type of columns that aren't always there, and what stands for an unknown value."""
Columns = dict[str, Any]  # Fields of many objects by name, each (N, ...); `None` where nothing is known


def place(boxes: Boxes3D, frames: Sequence[str], coordinates: CoordinateFrames, where: str) -> tuple[Boxes3D, bool]:
    """Return boxes, each in its own one of `frames`, in body coordinates; or all in those of the world, and say so.
    Raises ConfigError for an unknown coordinate frame, LogError where only some boxes are in the world.
    """
    names = list(dict.fromkeys(frames))
    worlds = [name for name in names if coordinates.is_world(name)]
    if worlds and len(worlds) < len(names):
        other = next(name for name in names if name not in worlds)
        raise LogError(f"{where}: boxes in '{worlds[0]}' and in '{other or 'body'}' at one instant; use one of them")
    if worlds or not names:
        return boxes, bool(worlds)
    if len(names) == 1:
        return _move_to_body(boxes, names[0], coordinates, where), False
    owners = np.array(frames, np.str_)
    center, yaw, pitch, roll = boxes.center_m.copy(), boxes.yaw_rad.copy(), np.zeros(len(boxes)), np.zeros(len(boxes))
    velocity = None if boxes.velocity_mps is None else boxes.velocity_mps.copy()
    for name in names:
        rows = np.flatnonzero(owners == name)
        part = _move_to_body(boxes[rows], name, coordinates, where)
        center[rows], yaw[rows] = part.center_m, part.yaw_rad
        pitch[rows] = 0.0 if part.pitch_rad is None else part.pitch_rad
        roll[rows] = 0.0 if part.roll_rad is None else part.roll_rad
        if velocity is not None and part.velocity_mps is not None:
            velocity[rows] = part.velocity_mps
    moved = replace(boxes, center_m=center, yaw_rad=yaw, pitch_rad=pitch, roll_rad=roll, velocity_mps=velocity)
    return moved, False


def _move_to_body(boxes: Boxes3D, name: str, coordinates: CoordinateFrames, where: str) -> Boxes3D:
    return boxes if name in ("", "body", coordinates.body) else move_boxes(boxes, body_T(name, coordinates, where))


def body_T(name: str, coordinates: CoordinateFrames, where: str) -> Float64:
    """Return the matrix (4, 4) from a coordinate frame to the body. Raises ConfigError where it isn't known, LogError
    where it lies elsewhere on the body later in the log: stamps and frames of files don't say from which on.
    """
    try:
        matrix = coordinates.body_T(name)
    except DecodeError as error:
        raise LogError(f"{where}: coordinate frame '{name}': {error}", "CAL001") from error
    if matrix is None and name in WORLDS:
        advice = f"name a topic with poses in '{name}' as body.pose"
        raise ConfigError(f"{where}: boxes in '{name}', but the log's poses are in '{coordinates.world}'; {advice}")
    if matrix is None:
        known = {"body", "world", coordinates.world, coordinates.body, *coordinates.rig.mounts, *coordinates.tree.edges}
        hint = did_you_mean(name, sorted(known - {""}))
        raise ConfigError(f"{where}: coordinate frame '{name}' isn't in the log{hint}")
    if name in coordinates.moved():
        advice = "give them in 'body', or cut the log where its calibration changes"
        raise LogError(f"{where}: boxes in '{name}', which moves on the body within the log; {advice}", "CAL001")
    return matrix


def find_camera(name: str, coordinates: CoordinateFrames, where: str) -> str:
    """Return a camera by name, coordinate frame or topic; without a name the only one. ConfigError where none is it."""
    cameras = coordinates.rig.sensors("camera")
    found = coordinates.camera(name) if name else coordinates.only_camera()
    if found is None and name:
        raise ConfigError(f"{where}: '{name}' is no camera of the log{did_you_mean(name, cameras)}")
    if found is None:
        there = f"the log has {', '.join(cameras)}" if cameras else "the log has none"
        raise ConfigError(f"{where}: which camera are the boxes of? {there}; name it")
    return found


def default_camera(source: BoxSource, coordinates: CoordinateFrames) -> str:
    """Camera of 2D boxes where a file doesn't name it; a coordinate frame that was meant for 3D boxes alone is none."""
    is_frame = source.camera == source.frame and coordinates.camera(source.camera) is None
    return "" if is_frame else source.camera


@dataclass(frozen=True, slots=True)
class Solid:
    """A 3D box."""

    center_m: Triple
    size_lwh_m: Triple
    yaw_pitch_roll_rad: Triple  # R = Rz(yaw) Ry(pitch) Rx(roll)
    velocity_mps: Triple | None = None


@dataclass(frozen=True, slots=True)
class Flat:
    """A box in an image."""

    camera: str
    xyxy_px: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class LabeledObject:
    """One object at one instant; `None` where the file doesn't tell."""

    source_label: str
    solid: Solid | None = None
    flat: Flat | None = None
    label: str | None = None  # Where it doesn't follow from `source_label`
    score: float | None = None
    track_id: int | None = None
    ignore: bool | None = None
    visibility: float | None = None
    occlusion: float | None = None
    truncation: float | None = None
    attribute: str | None = None
    num_lidar_pts: int | None = None
    alpha_rad: float | None = None  # KITTI's angle of observation, which boxes have no place for


def _column(rows: Sequence[LabeledObject], name: str) -> Array | None:
    """One field of all rows; `None` where no row tells it."""
    values = [getattr(row, name) for row in rows]
    if all(value is None for value in values):
        return None
    dtype, absent = _OPTIONAL[name]
    known = [absent if value is None else value for value in values]
    return text_array(known) if dtype is np.str_ else np.array(known, dtype)


def to_boxes3d(objects: Sequence[LabeledObject]) -> Boxes3D:
    """Return the 3D boxes of objects, each in its own coordinate frame."""
    rows = [(row, row.solid) for row in objects if row.solid is not None]
    if not rows:
        return Boxes3D.empty()
    velocities = [solid.velocity_mps for _, solid in rows]
    is_moving = any(velocity is not None for velocity in velocities)
    turns = np.array([solid.yaw_pitch_roll_rad for _, solid in rows], np.float64)
    upright = not np.any(turns[:, 1:])
    return Boxes3D(
        np.array([solid.center_m for _, solid in rows], np.float64),
        np.array([solid.size_lwh_m for _, solid in rows], np.float64),
        turns[:, 0],
        pitch_rad=None if upright else turns[:, 1],
        roll_rad=None if upright else turns[:, 2],
        velocity_mps=np.array([_NONE3 if v is None else v for v in velocities], np.float64) if is_moving else None,
        **_common([row for row, _ in rows]),
    )


def to_boxes2d(objects: Sequence[LabeledObject]) -> Boxes2D:
    """Return the boxes in images of objects."""
    rows = [(row, row.flat) for row in objects if row.flat is not None]
    if not rows:
        return Boxes2D.empty()
    return Boxes2D(
        np.array([flat.camera for _, flat in rows], np.str_),
        np.array([flat.xyxy_px for _, flat in rows], np.float64),
        **_common([row for row, _ in rows]),
    )


def _common(rows: Sequence[LabeledObject]) -> dict[str, Any]:
    labels = [label(row.source_label) if row.label is None else row.label for row in rows]
    optional = {name: _column(rows, name) for name in _OPTIONAL if name != "alpha_rad"}  # boxes have no place for it
    return {
        "label": np.array(labels, np.str_),
        "source_label": text_array([row.source_label for row in rows]),
        **{name: column for name, column in optional.items() if column is not None},
    }


def to_columns(steps: Sequence[int], rows: Sequence[LabeledObject]) -> Columns:
    """Return N objects, each with its frame or stamp in `steps`, as columns, unsorted: `step`, `label` (the source's
    words in lower case), `track_id` (-1 where there is none), `score` (0 where there is none), geometry as in `Solid`
    and `Flat`, and what else is known.
    """
    solids, flats = [row.solid for row in rows], [row.flat for row in rows]
    known = [solid for solid in solids if solid is not None]
    has_solid, has_flat, has_velocity = bool(known), any(flats), any(solid.velocity_mps is not None for solid in known)
    yaws = [np.nan if solid is None else solid.yaw_pitch_roll_rad[0] for solid in solids]
    velocities = [None if solid is None else solid.velocity_mps for solid in solids]
    return {
        "step": np.array(steps, np.int64),
        "label": text_array([row.source_label.lower() for row in rows]),
        "track_id": np.array([-1 if row.track_id is None else row.track_id for row in rows], np.int64),
        "score": np.array([0.0 if row.score is None else row.score for row in rows]),
        "xyxy_px": np.array([_NONE4 if f is None else f.xyxy_px for f in flats]) if has_flat else None,
        "center_m": np.array([_NONE3 if s is None else s.center_m for s in solids]) if has_solid else None,
        "size_lwh_m": np.array([_NONE3 if s is None else s.size_lwh_m for s in solids]) if has_solid else None,
        "yaw_rad": np.array(yaws) if has_solid else None,
        "velocity_mps": np.array([_NONE3 if v is None else v for v in velocities]) if has_velocity else None,
        **{name: _column(rows, name) for name in ("alpha_rad", "occlusion", "truncation", "visibility")},
        "attribute": _column(rows, "attribute") if any(row.attribute for row in rows) else None,
        "num_points": _column(rows, "num_lidar_pts"),
        "ignore": _column(rows, "ignore") if any(row.ignore for row in rows) else None,
    }


def angles(x: float, y: float, z: float, w: float, where: str) -> Triple:
    """Return yaw, pitch, roll [rad] of a quaternion, R = Rz(yaw) Ry(pitch) Rx(roll); NaN: not finite, LogError: 0."""
    from scipy.spatial.transform import Rotation  # takes a while to import

    xyzw = np.array([x, y, z, w])
    if not np.isfinite(xyzw).all():
        return np.nan, np.nan, np.nan
    norm = float(np.hypot(np.hypot(x, y), np.hypot(z, w)))
    if norm == 0:
        raise LogError(f"{where}: rotation is the quaternion 0 0 0 0")
    if x == y == 0:
        return float(2 * np.arctan2(z, w)), 0.0, 0.0
    yaw, pitch, roll = Rotation.from_quat(xyzw / norm).as_euler("ZYX", suppress_warnings=True)
    return float(yaw), float(pitch), float(roll)


Frames = Iterable[tuple[int, list[LabeledObject]]]


def group_by_frame(rows: Iterable[tuple[int, LabeledObject]]) -> Frames:
    """Group rows by frame, whatever their order."""
    ordered = sorted(rows, key=lambda row: row[0])
    for number, group in groupby(ordered, key=lambda row: row[0]):
        yield number, [row for _, row in group]


def fill_frames(frames: Frames, first: int = 0, num: int = 0) -> Iterator[tuple[int, list[LabeledObject]]]:
    """Put frames without rows between the others, and behind them up to `num`; LimitError where far too many lack."""
    expected = first
    for number, objects in frames:
        if number - expected > _MAX_EMPTY:
            raise LimitError(f"frames {expected} to {number - 1} have no row; more than {_MAX_EMPTY} aren't filled in")
        yield from ((i, []) for i in range(expected, number))
        yield number, objects
        expected = number + 1
    yield from ((i, []) for i in range(expected, min(first + num, expected + _MAX_EMPTY)))
