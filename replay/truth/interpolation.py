"""Truth of one instant made of that before and after it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes2D, Boxes3D, concatenate
from fbench.replay.data.messages import Pose, Truth
from fbench.replay.engine.poses import pose_between, pose_of
from fbench.replay.geometry.iou import move_boxes
from fbench.replay.geometry.transforms import chain, inverse, wrap_angle
from fbench.replay.truth.labelling import Instant, is_real

B = TypeVar("B", Boxes2D, Boxes3D)
NO_ID = -1


def interpolate(own: B, other: B, share: float) -> tuple[B, Bool]:
    """Move boxes by `share` of the way to those of the same id at another instant: center, size, velocity, rectangle,
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
        name: _change(name, value, mine, other.arrays()[name][its], share)
        for name, value in own.arrays().items()
        if name in _LINEAR + _ANGLES and name in other.arrays()
    }
    return replace(own, **changes), is_moved


def brought(boxes: Boxes3D, dst_T_src: Float64 | None) -> Boxes3D:
    """Move boxes to other body coordinates, where these are known; they get no pitch and roll that they don't have."""
    if dst_T_src is None or not len(boxes):
        return boxes
    there = move_boxes(boxes, dst_T_src)
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


def _change(name: str, own: Array, rows: Int64, other: Array, share: float) -> Array:
    """Values of a field, those at `rows` moved towards `other`; what isn't known on both sides stays as it is."""
    result, here = own.copy(), own[rows]
    if name in _ANGLES:
        there = here + share * wrap_angle(other - here)
        there = np.where(np.abs(there) > np.pi, wrap_angle(there), there)
    else:
        there = here + share * (other - here)
    result[rows] = np.where(np.isfinite(there), there, here)
    return result


_UNKNOWN = np.full(7, np.nan)


class BodyMotion:
    """Interpolates between the poses of the frames of a segment, which a finished run knows, too: so truth that is
    added later gets the same numbers.

    Args:
        instants: The frames.
        values: (N, 7) where the body was at each: position [m] and quaternion x, y, z, w, NaN where unknown.
    """

    def __init__(self, instants: Sequence[Instant], values: Float64) -> None:
        self._values = {instant.index: value for instant, value in zip(instants, values, strict=True)}
        self._stamps: dict[int, Int64] = {}
        """Of the frames of each segment, within which they ascend."""
        self._indices: dict[int, list[int]] = {}
        of: dict[int, list[Instant]] = {}
        for instant in instants:
            of.setdefault(instant.segment, []).append(instant)
        for segment, members in of.items():
            ordered = sorted(members, key=lambda instant: instant.stamp_ns)
            self._stamps[segment] = np.array([instant.stamp_ns for instant in ordered], np.int64)
            self._indices[segment] = [instant.index for instant in ordered]

    def body_T_body(self, index: int, segment: int, stamp_ns: int) -> Float64 | None:
        """Return the transform (4, 4) from body coordinates at a stamp to those at frame `index` of a segment; `None`
        where it isn't known.
        """
        at_frame, at_stamp = pose_of(self._values[index]), pose_of(self._at(segment, stamp_ns))
        return None if at_frame is None or at_stamp is None else chain(inverse(at_frame), at_stamp)

    def is_known(self, index: int) -> bool:
        """Whether frame `index` has a pose."""
        return pose_of(self._values[index]) is not None

    def _at(self, segment: int, stamp_ns: int) -> Float64:
        stamps = self._stamps[segment]
        place = int(np.searchsorted(stamps, stamp_ns))
        after = self._pose(segment, place) if place < len(stamps) else None
        if after is None or after.stamp_ns == stamp_ns:
            return _UNKNOWN if after is None else np.concatenate([after.translation_m, after.rotation_xyzw])
        before = self._pose(segment, place - 1) if place else None
        return _UNKNOWN if before is None else pose_between(before, after, stamp_ns)

    def _pose(self, segment: int, row: int) -> Pose | None:
        value, stamp_ns = self._values[self._indices[segment][row]], int(self._stamps[segment][row])
        return None if np.isnan(value).any() else Pose("", stamp_ns, stamp_ns, value[:3], value[3:])


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


class Window:
    """Truths by stamp, each given out when all that are less than `reach_ns` later are known, and kept until none is
    looked at that is less than that later.
    """

    def __init__(self, reach_ns: int) -> None:
        self._reach_ns = reach_ns
        self._placed: list[Placed] = []
        self._num_done = 0

    def goes_back(self, truth: Truth) -> bool:
        """Whether a truth comes from a clock that was set back."""
        return bool(self._placed) and truth.stamp_ns < self._placed[-1].stamp_ns

    def add(self, placed: Placed) -> None:
        """Take the next truth."""
        self._placed.append(placed)

    def settle(self) -> Iterator[tuple[Placed, Placed | None]]:
        """Give out truths whose surroundings are known, each with the next one, and forget what is too old."""
        settled_ns = self._placed[-1].stamp_ns - self._reach_ns if self._placed else 0
        while self._num_done < len(self._placed) and self._placed[self._num_done].stamp_ns < settled_ns:
            yield self._give()
        old = sum(placed.stamp_ns < settled_ns - self._reach_ns for placed in self._placed[: self._num_done])
        del self._placed[:old]
        self._num_done -= old

    def rest(self) -> Iterator[tuple[Placed, Placed | None]]:
        """Give out all others, and begin anew."""
        while self._num_done < len(self._placed):
            yield self._give()
        self._placed, self._num_done = [], 0

    def _give(self) -> tuple[Placed, Placed | None]:
        self._num_done += 1
        return self._placed[self._num_done - 1], next(iter(self._placed[self._num_done :]), None)

    def before(self, stamp_ns: int, camera: str | None) -> Placed | None:
        """The last truth up to a stamp that labels a camera, or 3D boxes where that is `None`."""
        found = (p for p in reversed(self._placed) if p.stamp_ns <= stamp_ns)
        return next((p for p in found if self._labels(p, camera)), None)

    def after(self, stamp_ns: int, camera: str | None) -> Placed | None:
        """The first truth from a stamp on that labels a camera, or 3D boxes where that is `None`."""
        found = (p for p in self._placed if p.stamp_ns >= stamp_ns)
        return next((p for p in found if self._labels(p, camera)), None)

    def cameras(self, first_ns: int, last_ns: int) -> list[str]:
        """Those with boxes from one stamp to another."""
        near = [p.truth.boxes2d for p in self._placed if first_ns <= p.stamp_ns <= last_ns]
        return sorted({camera for boxes in near if boxes is not None for camera in boxes.camera.tolist()})

    def _labels(self, placed: Placed, camera: str | None) -> bool:
        """Whether a truth tells what was there. One without boxes of a camera says that nothing was, unless another
        truth of the same frame complements it.
        """
        if camera is None or placed.truth.boxes2d is None or not placed.is_source:
            return placed.is_source and camera is None and placed.truth.boxes3d is not None
        if placed.index is None or len(flat(placed.truth, camera)):
            return True
        return not any(p.index == placed.index and len(flat(p.truth, camera)) for p in self._placed)


def flat(truth: Truth, camera: str) -> Boxes2D:
    """The boxes of a camera."""
    boxes = Boxes2D.empty() if truth.boxes2d is None else truth.boxes2d
    return boxes[boxes.camera == camera]


@dataclass(frozen=True)
class Target:
    """The frame whose instant it is."""

    index: int
    stamp_ns: int
    segment: int


class TruthMoves:
    """Interpolates boxes between two truths at the instant of a frame.

    3D boxes are interpolated in body coordinates of that instant, which the poses hold still, so that a standing object
    stays where it is; where a pose isn't known, in those of each truth's own instant.
    """

    def __init__(self, motion: BodyMotion) -> None:
        self._motion = motion

    def solid(self, own: Truth, other: Truth, target: Target) -> tuple[Boxes3D, Bool]:
        """Return the 3D boxes (N,) of `own`, and which of them were moved; the rest stay as they are."""
        a, b = _solid(own), _solid(other)
        if own.in_world != other.in_world:
            return a, np.zeros(len(a), bool)
        here, there = a, b
        if not own.in_world:
            steps = [self._motion.body_T_body(target.index, target.segment, t.stamp_ns) for t in (own, other)]
            if steps[0] is not None and steps[1] is not None:
                here, there = brought(a, steps[0]), brought(b, steps[1])
        boxes, is_moved = interpolate(here, there, _share(own, other, target))
        return where(is_moved, boxes, a), is_moved

    def pixels(self, own: Truth, other: Truth, camera: str, target: Target) -> tuple[Boxes2D, Bool]:
        """Return the boxes (N,) of a camera in `own`, and which of them were moved; the rest stay as they are."""
        return interpolate(flat(own, camera), flat(other, camera), _share(own, other, target))

    def can_place(self, truth: Truth, target: Target) -> bool:
        """Whether 3D boxes can be given in body coordinates."""
        return not truth.in_world or self._motion.is_known(target.index)


def in_rows(parts: list[Boxes2D], rows: list[Int64]) -> Boxes2D:
    """Put parts together again, each of which had these rows of the whole."""
    return concatenate(parts)[np.argsort(np.concatenate(rows), kind="stable")]


def _share(own: Truth, other: Truth, target: Target) -> float:
    return (target.stamp_ns - own.stamp_ns) / (other.stamp_ns - own.stamp_ns)


def _solid(truth: Truth) -> Boxes3D:
    return Boxes3D.empty() if truth.boxes3d is None else truth.boxes3d
