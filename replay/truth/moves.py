"""Truth of one instant made of those before and after it."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Bool, Int64
from fbench.replay.boxes import Boxes2D, Boxes3D, concatenate
from fbench.replay.data import Truth
from fbench.replay.truth.between import brought, interpolated, where
from fbench.replay.truth.body_motion import BodyMotion
from fbench.replay.truth.window import flat


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
        boxes, is_moved = interpolated(here, there, _share(own, other, target))
        return where(is_moved, boxes, a), is_moved

    def pixels(self, own: Truth, other: Truth, camera: str, target: Target) -> tuple[Boxes2D, Bool]:
        """Return the boxes (N,) of a camera in `own`, and which of them were moved; the rest stay as they are."""
        return interpolated(flat(own, camera), flat(other, camera), _share(own, other, target))

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
