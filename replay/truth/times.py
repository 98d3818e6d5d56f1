"""Truth at the instants of the frames: moved there, and interpolated where that is wanted."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes2D, Boxes3D, concatenate
from fbench.replay.data.messages import Truth
from fbench.replay.truth.interpolation import BodyMotion, Placed, Target, TruthMoves, Window, in_rows
from fbench.replay.truth.labelling import TOLERANCE_NS, Instant, Labelling, alike

MAX_GAP_NS = 600_000_000
"""Truth moves to the instant of its frame only between truths that aren't farther apart: keyframes of 2 Hz, say."""
MAX_BETWEEN_MS = 60_000
_NO_CAMERA = ""  # Stands for all where nothing was in any of them
_Pair = tuple[Placed, Placed]


def make_max_between_ns(gap_ms: float) -> int:
    """Return how far truths may be apart for frames between them to get truth. Raises ConfigError where it isn't a time
    of at most a minute: so much truth is held in memory.
    """
    if not 0 <= gap_ms <= MAX_BETWEEN_MS:
        raise ConfigError(f"--interpolate-truth {gap_ms:g}: not a number of ms from 0 to {MAX_BETWEEN_MS}")
    return round(gap_ms * 1e6)


class TruthTimes:
    """Moves truth to the instants of its frames, by interpolation between truths; what can't be interpolated stays.

    Args:
        instants: Of all frames, or of some.
        poses: (N, 7) where the body was at each, NaN where unknown.
        max_between_ns: Frames without truth of their own get that of the objects which truths on both sides have, where
            those aren't farther apart than this; 0: none does.
    """

    def __init__(self, instants: Sequence[Instant], poses: Float64, max_between_ns: int = 0) -> None:
        self._labelling = Labelling(instants)
        self._moves = TruthMoves(BodyMotion(instants, poses))
        self._chosen = {instant.index for instant in instants if instant.is_chosen}
        self._max_between_ns = max_between_ns
        self._reach_ns = max(MAX_GAP_NS, max_between_ns) + TOLERANCE_NS
        self._window = Window(self._reach_ns)
        self._labeled: set[int] = set()
        self._between: set[int] = set()

    def match(self, truths: Iterator[Truth]) -> Iterator[tuple[int | None, Truth]]:
        """Yield truths with their frames as `Labelling.matched` does, at the instants of these, and truth of frames
        between. What belongs to no frame, but is what such truth is made of, is left out. Truths of a second or two
        are held in memory.
        """
        return self._labelling.match(self._time_truth(truths))

    def is_between(self, index: int) -> bool:
        """Whether a frame that was yielded has no truth of its own."""
        return index in self._between

    def _time_truth(self, truths: Iterator[Truth]) -> Iterator[Truth]:
        for index, truth in map(self._labelling.found, truths):
            if self._window.goes_back(truth):
                for given in self._window.rest():
                    yield from self._place_truth(*given)
            is_near = index is None or self._labelling.distance_ns(index, truth) <= self._reach_ns
            self._window.add(Placed(truth, index, is_near))
            if index is not None:
                self._labeled.add(index)
            for given in self._window.settle():
                yield from self._place_truth(*given)
        for given in self._window.rest():
            yield from self._place_truth(*given)

    def _place_truth(self, placed: Placed, following: Placed | None) -> Iterator[Truth]:
        """Yield a truth, and those of the frames between it and the next one."""
        between = [] if following is None or not self._max_between_ns else list(self._behind(placed, following))
        if placed.index is not None:
            yield self._at_frame(placed, self._target(placed.index))
        elif not placed.is_used:
            yield placed.truth
        yield from between

    def _target(self, index: int) -> Target:
        return Target(index, self._labelling.stamp_of(index), self._labelling.segment_of(index))

    def _at_frame(self, placed: Placed, target: Target) -> Truth:
        """A truth at the instant of its frame."""
        if placed.stamp_ns == target.stamp_ns or not placed.is_source:
            return placed.truth
        boxes3d, boxes2d = self._solid_at(placed, target), self._flat_at(placed, target)
        return replace(placed.truth, boxes3d=boxes3d, boxes2d=boxes2d)

    def _solid_at(self, placed: Placed, target: Target) -> Boxes3D | None:
        boxes = placed.truth.boxes3d
        if boxes is None or not len(boxes) or (other := self._partner(placed, target, None)) is None:
            return boxes
        return self._moves.solid(placed.truth, other.truth, target)[0]

    def _flat_at(self, placed: Placed, target: Target) -> Boxes2D | None:
        boxes = placed.truth.boxes2d
        if boxes is None or not len(boxes):
            return boxes
        parts, rows = [], []
        for camera in sorted(set(boxes.camera.tolist())):
            rows.append(np.flatnonzero(boxes.camera == camera))
            other = self._partner(placed, target, camera)
            kept = boxes[rows[-1]]
            parts.append(kept if other is None else self._moves.pixels(placed.truth, other.truth, camera, target)[0])
        return in_rows(parts, rows)

    def _partner(self, placed: Placed, target: Target, camera: str | None) -> Placed | None:
        """The next truth on the other side of its frame's instant."""
        side = self._window.after if placed.stamp_ns < target.stamp_ns else self._window.before
        other = side(target.stamp_ns, camera)
        return None if other is None or not self._fit(placed, other, target, MAX_GAP_NS) else other

    def _behind(self, placed: Placed, following: Placed) -> Iterator[Truth]:
        """Truth of the frames between two truths that have none of their own."""
        for index in self._labelling.between(placed.stamp_ns + 1, following.stamp_ns - 1):
            if index in self._chosen and index not in self._labeled:
                truth = self._make_truth(self._target(index))
                if truth is not None:
                    self._labeled.add(index)
                    self._between.add(index)
                    yield truth

    def _make_truth(self, target: Target) -> Truth | None:
        """What the truths on both sides of a frame's instant have in common."""
        solid = self._around(target, None)
        boxes3d = None if solid is None else self._solid_made(solid, target)
        boxes2d = self._flat_made(target)
        if boxes3d is None and boxes2d is None:
            return None
        in_world = solid is not None and solid[0].truth.in_world
        return Truth(target.stamp_ns, target.stamp_ns, boxes3d, boxes2d, None, target.index, in_world)

    def _solid_made(self, pair: _Pair, target: Target) -> Boxes3D | None:
        near, far = (placed.truth for placed in pair)
        if not (_has_ids(near.boxes3d) and _has_ids(far.boxes3d)) or not self._moves.can_place(near, target):
            return None
        boxes, is_moved = self._moves.solid(near, far, target)
        _use(pair)
        return boxes[is_moved]

    def _flat_made(self, target: Target) -> Boxes2D | None:
        first_ns, last_ns = target.stamp_ns - self._max_between_ns, target.stamp_ns + self._max_between_ns
        parts = []
        for camera in self._window.cameras(first_ns, last_ns) or [_NO_CAMERA]:
            pair = self._around(target, camera)
            if pair is None or not all(_has_ids(placed.truth.boxes2d) for placed in pair):
                return None
            boxes, is_moved = self._moves.pixels(pair[0].truth, pair[1].truth, camera, target)
            parts.append(boxes[is_moved])
            _use(pair)
        return concatenate(alike(parts))

    def _around(self, target: Target, camera: str | None) -> _Pair | None:
        """The truths on both sides of an instant, the nearer one first; of two as near the earlier one."""
        a, b = self._window.before(target.stamp_ns - 1, camera), self._window.after(target.stamp_ns + 1, camera)
        if a is None or b is None or not self._fit(a, b, target, self._max_between_ns):
            return None
        return (a, b) if target.stamp_ns - a.stamp_ns <= b.stamp_ns - target.stamp_ns else (b, a)

    def _fit(self, a: Placed, b: Placed, target: Target, max_gap_ns: int) -> bool:
        """Whether two truths are near enough, and all frames between and beside them are of the target's segment."""
        first_ns, last_ns = sorted((a.stamp_ns, b.stamp_ns))
        if last_ns - first_ns > max_gap_ns:
            return False
        frames = [*self._labelling.between(first_ns, last_ns), *self._beside(a), *self._beside(b)]
        return all(self._labelling.segment_of(index) == target.segment for index in frames)

    def _beside(self, placed: Placed) -> list[int]:
        """Its frame, or those before and after it."""
        return self._labelling.around(placed.stamp_ns) if placed.index is None else [placed.index]


def _has_ids(boxes: Boxes2D | Boxes3D | None) -> bool:
    return boxes is not None and (not len(boxes) or boxes.track_id is not None)


def _use(pair: _Pair) -> None:
    for placed in pair:
        placed.is_used = True
