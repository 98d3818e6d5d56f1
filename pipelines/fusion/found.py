"""Objects while they are put together from what the sensors see."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes3D


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
    return math.hypot(float(a.center_m[0]) - float(b.center_m[0]), float(a.center_m[1]) - float(b.center_m[1]))


def one_object(a: Found, b: Found, merge_m: float) -> bool:
    """Tell whether two boxes show one object: centres nearer than `merge_m`, or the centre of one inside the other.

    The latter matters for long vehicles, of which radar shows only the near end.
    """
    distance = distance_m(a, b)
    return distance < merge_m or (distance < _reach_m(a) and _holds(a, b)) or (distance < _reach_m(b) and _holds(b, a))


def _reach_m(box: Found) -> float:
    """No point of the box is farther from its middle, seen from above [m]."""
    return float(box.size_lwh_m[0] + box.size_lwh_m[1]) / 2


def _holds(box: Found, other: Found) -> bool:
    east, north = (other.center_m - box.center_m)[:2]
    cos, sin = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    along, across = abs(east * cos + north * sin), abs(north * cos - east * sin)
    return bool(along <= box.size_lwh_m[0] / 2 and across <= box.size_lwh_m[1] / 2)


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
