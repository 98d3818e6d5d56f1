"""Interpolation of boxes between two instants, and the motion of the body between them."""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from typing import TypeVar

import numpy as np

from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import Pose
from fbench.replay.engine.poses import pose_between, pose_of
from fbench.replay.geometry.iou import move_boxes
from fbench.replay.geometry.transforms import chain, inverse, wrap_angle
from fbench.replay.truth.labelling import Instant, is_real

B = TypeVar("B", Boxes2D, Boxes3D)
NO_ID = -1
_LINEAR = ("center_m", "size_lwh_m", "velocity_mps", "xyxy_px", "visible_xyxy_px", "distance_m", "range_rate_mps")
_ANGLES = ("yaw_rad", "roll_rad", "pitch_rad")
_UNKNOWN = np.full(7, np.nan)


def interpolate(own: B, other: B, share: float) -> tuple[B, Bool]:
    """Move boxes (N,) by `share`, 0 to 1, of the way to those of the same id at another instant, in the same
    coordinates or of the same camera: center, size, velocity, rectangle, distance and range rate linearly, yaw, pitch
    and roll along the shorter arc. All else stays as it is, and so does what isn't known on both sides. Return the
    boxes, and which of them (N,) moved: those whose id is there once on both sides, with boxes that are real.
    """
    (own_ids, own_rows), (other_ids, other_rows) = _ids_there_once(own), _ids_there_once(other)
    _, mine, its = np.intersect1d(own_ids, other_ids, return_indices=True)
    mine, its = own_rows[mine], other_rows[its]
    real = is_real(own)[mine] & is_real(other)[its]
    mine, its = mine[real], its[real]
    is_moved = np.zeros(len(own), bool)
    is_moved[mine] = True
    columns, changes = other.arrays(), {}
    for name, value in own.arrays().items():
        if name in _LINEAR + _ANGLES and name in columns:
            here, there = value[mine], columns[name][its]
            if name in _ANGLES:
                there = here + share * wrap_angle(there - here)
                there = np.where(np.abs(there) > np.pi, wrap_angle(there), there)
            else:
                there = here + share * (there - here)
            changes[name] = value.copy()
            changes[name][mine] = np.where(np.isfinite(there), there, here)
    return replace(own, **changes), is_moved


def _ids_there_once(boxes: Boxes2D | Boxes3D) -> tuple[Int64, Int64]:
    """Ids that one box alone has, ascending, and its row."""
    if boxes.track_id is None:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    ids, first, counts = np.unique(boxes.track_id, return_index=True, return_counts=True)
    once = (counts == 1) & (ids != NO_ID)
    return ids[once], np.asarray(first[once], np.int64)


def move_to_body(boxes: Boxes3D, dst_T_src: Float64) -> Boxes3D:
    """Move boxes to other body coordinates; they get no pitch and roll that they don't have."""
    if not len(boxes):
        return boxes
    there = move_boxes(boxes, dst_T_src)
    return replace(
        there,
        roll_rad=None if boxes.roll_rad is None else there.roll_rad,
        pitch_rad=None if boxes.pitch_rad is None else there.pitch_rad,
    )


class BodyMotion:
    """Interpolates between the poses of the frames of a segment, (N, 7) position [m] and quaternion x, y, z, w, NaN
    where unknown. A finished run knows these, too: so truth that is added later gets the same numbers.
    """

    def __init__(self, instants: Sequence[Instant], values: Float64) -> None:
        self._values: dict[int, Float64] = {i.index: value for i, value in zip(instants, values, strict=True)}
        ordered = sorted(instants, key=lambda instant: (instant.segment, instant.stamp_ns))
        self._segments = {segment: list(own) for segment, own in groupby(ordered, key=lambda instant: instant.segment)}

    def body_T_body(self, frame: Instant, stamp_ns: int) -> Float64 | None:
        """Return the transform (4, 4) from the body at a stamp to that at a frame of its segment, where it is known."""
        at_frame, at_stamp = pose_of(self._values[frame.index]), pose_of(self._at(frame.segment, stamp_ns))
        return None if at_frame is None or at_stamp is None else chain(inverse(at_frame), at_stamp)

    def is_known(self, frame: Instant) -> bool:
        """Whether a frame has a pose."""
        return pose_of(self._values[frame.index]) is not None

    def _at(self, segment: int, stamp_ns: int) -> Float64:
        frames = self._segments[segment]
        place = bisect_left(frames, stamp_ns, key=lambda frame: frame.stamp_ns)
        if place < len(frames) and frames[place].stamp_ns == stamp_ns:
            return self._values[frames[place].index]
        around = frames[place - 1 : place + 1] if place else []
        values = [self._values[frame.index] for frame in around]
        if len(around) < 2 or np.isnan(values).any():
            return _UNKNOWN
        before, after = (Pose("", f.stamp_ns, f.stamp_ns, v[:3], v[3:]) for f, v in zip(around, values, strict=True))
        return pose_between(before, after, stamp_ns)
