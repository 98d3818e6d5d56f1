"""Truth at the instants of the frames: moved there, and interpolated where that is wanted."""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any, TypeVar

import numpy as np

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes2D, Boxes3D, concatenate
from fbench.replay.data.messages import Pose, Truth
from fbench.replay.engine.poses import pose_between, pose_of
from fbench.replay.geometry.iou import move_boxes
from fbench.replay.geometry.transforms import chain, inverse, wrap_angle
from fbench.replay.truth.labelling import TOLERANCE_NS, Instant, Labelling, drop_unshared, is_real

MAX_GAP_NS = 600_000_000  # Truth moves to its frame's instant only between truths nearer than this: keyframes of 2 Hz
MAX_BETWEEN_MS = 60_000
_NO_CAMERA = ""  # Stands for all where nothing was in any of them
B = TypeVar("B", Boxes2D, Boxes3D)
NO_ID = -1
_LINEAR = ("center_m", "size_lwh_m", "velocity_mps", "xyxy_px", "visible_xyxy_px", "distance_m", "range_rate_mps")
_ANGLES = ("yaw_rad", "roll_rad", "pitch_rad")


def make_max_between_ns(gap_ms: float) -> int:
    """Return how far apart truths may be that frames between get truth of. ConfigError over a minute (of memory)."""
    if not 0 <= gap_ms <= MAX_BETWEEN_MS:
        raise ConfigError(f"--interpolate-truth {gap_ms:g}: not a number of ms from 0 to {MAX_BETWEEN_MS}")
    return round(gap_ms * 1e6)


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
    absent: dict[str, Any] = {name: None for name in ("roll_rad", "pitch_rad") if getattr(boxes, name) is None}
    return replace(move_boxes(boxes, dst_T_src), **absent)


@dataclass(eq=False)
class Placed:
    """A truth with its frame."""

    truth: Truth
    index: int | None
    is_source: bool  # Whether its stamp is of the clock of the frames, so that others can be interpolated with it
    is_used: bool = False  # Whether a frame between truths got boxes from it

    @property
    def stamp_ns(self) -> int:
        """Its stamp."""
        return self.truth.stamp_ns


_Pair = tuple[Placed, Placed]


class TruthTimes:
    """Moves truth to the instants of frames, all or some, by interpolation between truths; what can't be interpolated
    stays. Frames without truth of their own get that of the objects which truths on both sides have, where those aren't
    farther apart than `max_between_ns`; 0: none does.

    3D boxes are interpolated in body coordinates of that instant, which the poses, (N, 7) position [m] and quaternion
    x, y, z, w, NaN where unknown, hold still, so that a standing object stays where it is; where a pose isn't known, in
    those of each truth's own instant.
    """

    def __init__(self, instants: Sequence[Instant], poses: Float64, max_between_ns: int = 0) -> None:
        self._labelling = Labelling(instants)
        self._poses: dict[int, Float64] = {i.index: pose for i, pose in zip(instants, poses, strict=True)}
        ordered = sorted(instants, key=lambda instant: (instant.segment, instant.stamp_ns))
        self._segments = {segment: list(own) for segment, own in groupby(ordered, key=lambda instant: instant.segment)}
        self._max_between_ns = max_between_ns
        self._reach_ns = max(MAX_GAP_NS, max_between_ns) + TOLERANCE_NS
        self._window: list[Placed] = []  # Truths by stamp, none much older than those that aren't done
        self._num_done = 0  # Of the window
        self._labeled: set[int] = set()
        self._between: set[int] = set()

    def match(self, truths: Iterator[Truth]) -> Iterator[tuple[int | None, Truth]]:
        """Yield truths with their frames as `Labelling.match` does, at the instants of these, and truth of frames
        between. What belongs to no frame, but is what such truth is made of, is left out. Truths of a second or two
        are held in memory.
        """
        return self._labelling.match(self._time_truth(truths))

    def is_between(self, index: int) -> bool:
        """Whether a frame that was yielded has no truth of its own."""
        return index in self._between

    def _time_truth(self, truths: Iterator[Truth]) -> Iterator[Truth]:
        for index, truth in map(self._labelling.locate, truths):
            if self._window and truth.stamp_ns < self._window[-1].stamp_ns:  # from a clock that was set back
                yield from self._settle(None)
            is_near = index is None or self._labelling.distance_ns(index, truth) <= self._reach_ns
            self._window.append(Placed(truth, index, is_near))
            if index is not None:
                self._labeled.add(index)
            yield from self._settle(truth.stamp_ns - self._reach_ns)
        yield from self._settle(None)

    def _settle(self, stamp_ns: int | None) -> Iterator[Truth]:
        """Finish truths before a stamp, with all known around them, and forget old ones; `None`: finish all."""
        while self._num_done < len(self._window):
            placed, *following = self._window[self._num_done : self._num_done + 2]
            if stamp_ns is not None and placed.stamp_ns >= stamp_ns:
                break
            self._num_done += 1
            between = list(self._fill(placed, following[0])) if following and self._max_between_ns else []
            if placed.index is not None:
                yield self._move(placed, self._labelling.instants[placed.index])
            elif not placed.is_used:
                yield placed.truth
            yield from between
        old = self._num_done
        if stamp_ns is not None:
            old = sum(placed.stamp_ns < stamp_ns - self._reach_ns for placed in self._window[: self._num_done])
        del self._window[:old]
        self._num_done -= old

    def _move(self, placed: Placed, frame: Instant) -> Truth:
        """A truth at the instant of its frame."""
        truth = placed.truth
        if placed.stamp_ns == frame.stamp_ns or not placed.is_source:
            return truth
        boxes3d, boxes2d = truth.boxes3d, truth.boxes2d
        if boxes3d is not None and len(boxes3d) and (other := self._find_opposite(placed, frame, None)) is not None:
            boxes3d = self._interpolate_3d(truth, other.truth, frame)[0]
        if boxes2d is not None and len(boxes2d):
            parts, rows = [], []
            for camera in sorted(set(boxes2d.camera.tolist())):
                rows.append(np.flatnonzero(boxes2d.camera == camera))
                other = self._find_opposite(placed, frame, camera)
                kept = boxes2d[rows[-1]]
                parts.append(kept if other is None else _interpolate_2d(truth, other.truth, camera, frame)[0])
            boxes2d = concatenate(parts)[np.argsort(np.concatenate(rows), kind="stable")]
        return replace(truth, boxes3d=boxes3d, boxes2d=boxes2d)

    def _find_opposite(self, placed: Placed, frame: Instant, camera: str | None) -> Placed | None:
        """The next truth on the other side of its frame's instant."""
        other = self._find(frame.stamp_ns, camera, is_after=placed.stamp_ns < frame.stamp_ns)
        return None if other is None or not self._fit(placed, other, frame, MAX_GAP_NS) else other

    def _fill(self, placed: Placed, following: Placed) -> Iterator[Truth]:
        """Truth of the unlabeled frames between two truths: what the truths around a frame's instant have in common."""
        for index in self._labelling.between(placed.stamp_ns + 1, following.stamp_ns - 1):
            frame = self._labelling.instants[index]
            if not frame.is_chosen or index in self._labeled:
                continue
            solid = self._find_around(frame, None)
            boxes3d, boxes2d = None if solid is None else self._make_3d(solid, frame), self._make_2d(frame)
            if boxes3d is not None or boxes2d is not None:
                self._labeled.add(index)
                self._between.add(index)
                in_world = solid is not None and solid[0].truth.in_world
                yield Truth(frame.stamp_ns, frame.stamp_ns, boxes3d, boxes2d, None, index, in_world)

    def _make_3d(self, pair: _Pair, frame: Instant) -> Boxes3D | None:
        near, far = (placed.truth for placed in pair)
        can_place = not near.in_world or pose_of(self._poses[frame.index]) is not None
        if not (_has_ids(near.boxes3d) and _has_ids(far.boxes3d) and can_place):
            return None
        boxes, is_moved = self._interpolate_3d(near, far, frame)
        pair[0].is_used = pair[1].is_used = True
        return boxes[is_moved]

    def _make_2d(self, frame: Instant) -> Boxes2D | None:
        first_ns, last_ns = frame.stamp_ns - self._max_between_ns, frame.stamp_ns + self._max_between_ns
        near = [placed.truth.boxes2d for placed in self._window if first_ns <= placed.stamp_ns <= last_ns]
        cameras = sorted({camera for boxes in near if boxes is not None for camera in boxes.camera.tolist()})
        parts = []
        for camera in cameras or [_NO_CAMERA]:
            pair = self._find_around(frame, camera)
            if pair is None or not all(_has_ids(placed.truth.boxes2d) for placed in pair):
                return None
            boxes, is_moved = _interpolate_2d(pair[0].truth, pair[1].truth, camera, frame)
            parts.append(boxes[is_moved])
            pair[0].is_used = pair[1].is_used = True
        return concatenate(drop_unshared(parts))

    def _find_around(self, frame: Instant, camera: str | None) -> _Pair | None:
        """The truths on both sides of an instant, the nearer one first; of two as near the earlier one."""
        a = self._find(frame.stamp_ns - 1, camera, is_after=False)
        b = self._find(frame.stamp_ns + 1, camera, is_after=True)
        if a is None or b is None or not self._fit(a, b, frame, self._max_between_ns):
            return None
        return (a, b) if frame.stamp_ns - a.stamp_ns <= b.stamp_ns - frame.stamp_ns else (b, a)

    def _find(self, stamp_ns: int, camera: str | None, *, is_after: bool) -> Placed | None:
        """The first truth from a stamp on, or the last one up to it, that labels a camera; `None`: 3D boxes."""
        sign = 1 if is_after else -1
        found = (placed for placed in self._window[::sign] if sign * (placed.stamp_ns - stamp_ns) >= 0)
        return next((placed for placed in found if self._labels(placed, camera)), None)

    def _labels(self, placed: Placed, camera: str | None) -> bool:
        """Whether a truth says what was there. Without boxes of a camera nothing was, if none of its frame has any."""
        if camera is None or placed.truth.boxes2d is None or not placed.is_source:
            return placed.is_source and camera is None and placed.truth.boxes3d is not None
        if placed.index is None or len(_boxes_of(placed.truth, camera)):
            return True
        return not any(other.index == placed.index and len(_boxes_of(other.truth, camera)) for other in self._window)

    def _fit(self, a: Placed, b: Placed, frame: Instant, max_gap_ns: int) -> bool:
        """Whether two truths are near enough, and all frames between and beside them are of the frame's segment."""
        first_ns, last_ns = sorted((a.stamp_ns, b.stamp_ns))
        if last_ns - first_ns > max_gap_ns:
            return False
        indices = self._labelling.between(first_ns, last_ns)
        for placed in (a, b):
            indices += self._labelling.around(placed.stamp_ns) if placed.index is None else [placed.index]
        return all(self._labelling.instants[index].segment == frame.segment for index in indices)

    def _interpolate_3d(self, own: Truth, other: Truth, frame: Instant) -> tuple[Boxes3D, Bool]:
        """3D boxes (N,) of `own` at the instant of a frame, and which of them were moved; the rest stay as they are."""
        a, b = (Boxes3D.empty() if truth.boxes3d is None else truth.boxes3d for truth in (own, other))
        if own.in_world != other.in_world:
            return a, np.zeros(len(a), bool)
        here, there = a, b
        if not own.in_world:
            own_T, other_T = (self._body_T_body(frame, truth.stamp_ns) for truth in (own, other))
            if own_T is not None and other_T is not None:
                here, there = move_to_body(a, own_T), move_to_body(b, other_T)
        boxes, is_moved = interpolate(here, there, _share(own, other, frame))
        still, moved = a.arrays(), boxes.arrays().items()
        rows = {name: np.where(is_moved.reshape(-1, *[1] * (x.ndim - 1)), x, still[name]) for name, x in moved}
        return replace(boxes, **rows), is_moved

    def _body_T_body(self, frame: Instant, stamp_ns: int) -> Float64 | None:
        """Transform (4, 4) from the body at a stamp to that at a frame of its segment; `None` where unknown."""
        # From the poses of frames alone, which a finished run has, too: later truth gets the same numbers.
        frames = self._segments[frame.segment]
        place = bisect_left(frames, stamp_ns, key=lambda other: other.stamp_ns)
        if place < len(frames) and frames[place].stamp_ns == stamp_ns:
            at_stamp = pose_of(self._poses[frames[place].index])
        else:
            around = [(f.stamp_ns, self._poses[f.index]) for f in (frames[place - 1 : place + 1] if place else [])]
            if len(around) < 2 or any(np.isnan(value).any() for _, value in around):
                return None
            before, after = (Pose("", stamp, stamp, value[:3], value[3:]) for stamp, value in around)
            at_stamp = pose_of(pose_between(before, after, stamp_ns))
        at_frame = pose_of(self._poses[frame.index])
        return None if at_frame is None or at_stamp is None else chain(inverse(at_frame), at_stamp)


def _interpolate_2d(own: Truth, other: Truth, camera: str, frame: Instant) -> tuple[Boxes2D, Bool]:
    return interpolate(_boxes_of(own, camera), _boxes_of(other, camera), _share(own, other, frame))


def _boxes_of(truth: Truth, camera: str) -> Boxes2D:
    boxes = Boxes2D.empty() if truth.boxes2d is None else truth.boxes2d
    return boxes[boxes.camera == camera]


def _share(own: Truth, other: Truth, frame: Instant) -> float:
    return (frame.stamp_ns - own.stamp_ns) / (other.stamp_ns - own.stamp_ns)


def _has_ids(boxes: Boxes2D | Boxes3D | None) -> bool:
    return boxes is not None and (not len(boxes) or boxes.track_id is not None)
