"""Labelled objects as a file tells them one by one, and the boxes that they make."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fbench.replay.arrays import Array, text_array
from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.classes import label

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Solid:
    """A 3D box."""

    center_m: Triple
    size_lwh_m: Triple
    yaw_pitch_roll_rad: Triple
    """R = Rz(yaw) Ry(pitch) Rx(roll)."""
    velocity_mps: Triple | None = None
    frame: str = ""
    """Its coordinate frame; empty: the body."""


@dataclass(frozen=True, slots=True)
class Flat:
    """A box in an image."""

    camera: str
    xyxy_px: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Labelled:
    """One object at one instant; `None` where the file doesn't tell."""

    source_label: str
    solid: Solid | None = None
    flat: Flat | None = None
    label: str | None = None
    """Where it doesn't follow from `source_label`."""
    score: float | None = None
    track_id: int | None = None
    ignore: bool | None = None
    visibility: float | None = None
    occlusion: float | None = None
    truncation: float | None = None
    attribute: str | None = None
    num_lidar_pts: int | None = None
    alpha_rad: float | None = None
    """KITTI's angle of observation, which boxes have no place for."""


_OPTIONAL: tuple[tuple[str, Any, Any], ...] = (
    ("score", np.float64, np.nan), ("track_id", np.int64, -1), ("ignore", np.bool_, False),
    ("visibility", np.float64, np.nan), ("occlusion", np.float64, np.nan), ("truncation", np.float64, np.nan),
    ("attribute", np.str_, ""), ("num_lidar_pts", np.int64, -1),
)  # fmt: skip


def solids(objects: Sequence[Labelled]) -> Boxes3D:
    """Return the 3D boxes of objects, each in its own coordinate frame."""
    rows = [(row, row.solid) for row in objects if row.solid is not None]
    if not rows:
        return Boxes3D.empty()
    angles = np.array([solid.yaw_pitch_roll_rad for _, solid in rows], np.float64)
    upright = not np.any(angles[:, 1:])
    return Boxes3D(
        np.array([solid.center_m for _, solid in rows], np.float64),
        np.array([solid.size_lwh_m for _, solid in rows], np.float64),
        angles[:, 0],
        pitch_rad=None if upright else angles[:, 1],
        roll_rad=None if upright else angles[:, 2],
        velocity_mps=_velocities([solid for _, solid in rows]),
        **_common([row for row, _ in rows]),
    )


def flats(objects: Sequence[Labelled]) -> Boxes2D:
    """Return the boxes in images of objects."""
    rows = [(row, row.flat) for row in objects if row.flat is not None]
    if not rows:
        return Boxes2D.empty()
    return Boxes2D(
        np.array([flat.camera for _, flat in rows], np.str_),
        np.array([flat.xyxy_px for _, flat in rows], np.float64),
        **_common([row for row, _ in rows]),
    )


def _velocities(rows: Sequence[Solid]) -> Array | None:
    told = [row.velocity_mps for row in rows]
    if all(velocity is None for velocity in told):
        return None
    return np.array([(np.nan,) * 3 if velocity is None else velocity for velocity in told], np.float64)


def _common(rows: Sequence[Labelled]) -> dict[str, Any]:
    columns: dict[str, Any] = {
        "label": np.array([label(row.source_label) if row.label is None else row.label for row in rows], np.str_),
        "source_label": text_array([row.source_label for row in rows]),
    }
    for name, dtype, absent in _OPTIONAL:
        values = [getattr(row, name) for row in rows]
        if any(value is not None for value in values):
            there = [absent if value is None else value for value in values]
            columns[name] = text_array(there) if dtype is np.str_ else np.array(there, dtype)
    return columns
