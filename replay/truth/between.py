"""Boxes of one instant from those of the instants before and after it."""

from dataclasses import replace
from typing import TypeVar

import numpy as np

from fbench.replay.arrays import Array, Bool, Float64, Int64
from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.geometry.boxes import moved
from fbench.replay.geometry.transforms import wrap_angle
from fbench.replay.truth.fitted import is_real

B = TypeVar("B", Boxes2D, Boxes3D)
NO_ID = -1


def interpolated(own: B, other: B, share: float) -> tuple[B, Bool]:
    """Move boxes by `share` of the way to those of the same id at another instant: centre, size, velocity, rectangle,
    distance and range rate linearly, yaw, pitch and roll along the shorter arc. All else stays as it is.

    Args:
        own: Boxes (N,).
        other: Boxes of the other instant, in the same coordinates; 2D ones of the same camera.
        share: From 0 to 1.

    Returns:
        The boxes, and which of them (N,) moved: those whose id is there once on both sides, with boxes that are real.
    """
    mine, its = _partners(own, other)
    is_moved = np.zeros(len(own), bool)
    is_moved[mine] = True
    changes = {
        name: _changed(name, value, mine, other.arrays()[name][its], share)
        for name, value in own.arrays().items()
        if name in _LINEAR + _ANGLES and name in other.arrays()
    }
    return replace(own, **changes), is_moved


def brought(boxes: Boxes3D, dst_T_src: Float64 | None) -> Boxes3D:
    """Move boxes to other body coordinates, where these are known; they get no pitch and roll that they don't have."""
    if dst_T_src is None or not len(boxes):
        return boxes
    there = moved(boxes, dst_T_src)
    return replace(
        there,
        roll_rad=None if boxes.roll_rad is None else there.roll_rad,
        pitch_rad=None if boxes.pitch_rad is None else there.pitch_rad,
    )


def where(mask: Bool, a: Boxes3D, b: Boxes3D) -> Boxes3D:
    """Rows of `a` where `mask` (N,) is true, else those of `b`, which has the same fields."""
    rows = {
        name: np.where(mask.reshape(-1, *[1] * (x.ndim - 1)), x, b.arrays()[name]) for name, x in a.arrays().items()
    }
    return replace(a, **rows)


_LINEAR = ("center_m", "size_lwh_m", "velocity_mps", "xyxy_px", "visible_xyxy_px", "distance_m", "range_rate_mps")
_ANGLES = ("yaw_rad", "roll_rad", "pitch_rad")


def _partners(own: Boxes2D | Boxes3D, other: Boxes2D | Boxes3D) -> tuple[Int64, Int64]:
    """Rows of either side that are the same object."""
    if own.track_id is None or other.track_id is None:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    _, mine, its = np.intersect1d(_once(own.track_id), _once(other.track_id), return_indices=True)
    mine, its = _rows(own.track_id)[mine], _rows(other.track_id)[its]
    real = is_real(own)[mine] & is_real(other)[its]
    return mine[real], its[real]


def _rows(ids: Int64) -> Int64:
    """Rows of the ids that are there once, by id."""
    values, first, counts = np.unique(ids, return_index=True, return_counts=True)
    return np.asarray(first[(counts == 1) & (values != NO_ID)], np.int64)


def _once(ids: Int64) -> Int64:
    return ids[_rows(ids)]


def _changed(name: str, own: Array, rows: Int64, other: Array, share: float) -> Array:
    """Values of a field, those at `rows` moved towards `other`; what isn't known on both sides stays as it is."""
    result, here = own.copy(), own[rows]
    if name in _ANGLES:
        there = here + share * wrap_angle(other - here)
        there = np.where(np.abs(there) > np.pi, wrap_angle(there), there)
    else:
        there = here + share * (other - here)
    result[rows] = np.where(np.isfinite(there), there, here)
    return result
