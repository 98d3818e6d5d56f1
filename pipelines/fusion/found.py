"""Objects while they are put together from what the sensors see."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.pipelines.fusion.params import FusionParams
from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes3D

LONG_CAR_M = 7.0
"""Objects without a camera's label that are longer than this [m] are called trucks, others cars."""


@dataclass(frozen=True, eq=False)
class Found:
    """One object in body coordinates."""

    center_m: Float64
    """(3,) [m]."""
    size_lwh_m: Float64
    """(3,) length, width, height [m]."""
    yaw_rad: float
    """Heading [rad]."""
    velocity_mps: Float64
    """(3,) over ground [m/s]; NaN where unknown."""
    label: str
    """One of `LABELS`."""
    score: float
    """How sure it is that the object exists, 0 to 1."""
    sources: int
    """Bits of `Source`."""


def distance_m(a: Found, b: Found) -> float:
    """Distance of two centres on the ground [m]."""
    return float(np.hypot(a.center_m[0] - b.center_m[0], a.center_m[1] - b.center_m[1]))


def one_object(a: Found, b: Found, merge_m: float) -> bool:
    """Tell whether two boxes show one object: centres nearer than `merge_m`, or the centre of one inside the other.

    The latter matters for long vehicles, of which radar shows only the near end.
    """
    return distance_m(a, b) < merge_m or _holds(a, b) or _holds(b, a)


def _holds(box: Found, other: Found) -> bool:
    east, north = (other.center_m - box.center_m)[:2]
    cos, sin = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    along, across = abs(east * cos + north * sin), abs(north * cos - east * sin)
    return bool(along <= box.size_lwh_m[0] / 2 and across <= box.size_lwh_m[1] / 2)


def joined_score(*scores: float) -> float:
    """Probability that at least one of several independent witnesses is right."""
    return float(1 - np.prod([1 - score for score in scores]))


def row(boxes: Boxes3D, at: int, weight: float, source: int) -> Found:
    """Take one box of a sensor without classes."""
    size = boxes.size_lwh_m[at]
    velocity = np.full(3, np.nan) if boxes.velocity_mps is None else boxes.velocity_mps[at]
    score = 0.0 if boxes.score is None else float(boxes.score[at])
    label = "truck" if size[0] > LONG_CAR_M else "car"
    return Found(boxes.center_m[at], size, float(boxes.yaw_rad[at]), velocity, label, weight * score, source)


def radar_weight(boxes: Boxes3D, at: int, params: FusionParams) -> float:
    """How far a radar's box is believed: clusters without velocity may be anything that stands."""
    moves = boxes.velocity_mps is not None and bool(np.isfinite(boxes.velocity_mps[at]).any())
    return params.radar_weight if moves else params.standing_weight


def to_boxes(objects: Sequence[Found]) -> Boxes3D:
    """Boxes by falling score, equal scores by place; the same fields for any number of objects."""
    ordered = sorted(objects, key=lambda o: (-o.score, *o.center_m.tolist()))
    return Boxes3D(
        center_m=np.array([o.center_m for o in ordered]).reshape(-1, 3),
        size_lwh_m=np.array([o.size_lwh_m for o in ordered]).reshape(-1, 3),
        yaw_rad=np.array([o.yaw_rad for o in ordered], np.float64),
        velocity_mps=np.array([o.velocity_mps for o in ordered]).reshape(-1, 3),
        label=np.array([o.label for o in ordered], np.str_),
        score=np.array([o.score for o in ordered], np.float64),
        sources=np.array([o.sources for o in ordered], np.uint8),
    )
