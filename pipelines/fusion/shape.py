"""What LiDAR points show of an object whose class is known: a rectangle, completed to the class's typical size."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.fusion.lift import SIZES
from fbench.pipelines.points.rectangle_kernel import HEADINGS_RAD, NEAR_M, fit_rectangles
from fbench.pipelines.points.vehicle import VehicleSize, complete
from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes3D

_ENOUGH = 300
_TELLING_M = 2.2
_SURE_M = 0.15
_MISSING_SHARE = 0.1


@dataclass(frozen=True, eq=False)
class Shape:
    """Box on the ground by LiDAR."""

    xy_m: Float64
    """(2,) middle [m]."""
    size_lwh_m: Float64
    """(3,) [m]."""
    yaw_rad: float
    std_along_m: float
    """Error of the middle along the heading [m], a share of what isn't seen of the length."""
    std_across_m: float
    """The same across it."""
    tells_heading: bool
    """Whether enough of a side is seen."""


def lidar_shape(points: Float64, box: Boxes3D, label: str, eye_m: Float64, is_part: bool) -> Shape:
    """Complete points (N, 3) of one object, seen from `eye_m` (2,), to the size of its class; `box`: the detector's.

    The detector's box is taken as it is where it means the same class (a car, where it knows none), unless the points
    are only a part of its cluster.
    """
    meant = "car" if box.label is None else str(box.label[0])
    if len(points) < 2 or (label in ("", meant) and not is_part):
        center, size, yaw = box.center_m[0, :2], box.size_lwh_m[0], float(box.yaw_rad[0])
    else:
        center, size, yaw = _completed(points, label, eye_m, float(box.size_lwh_m[0, 2]))
    seen_m = _extents(points, yaw)
    missing = np.maximum(size[:2] - seen_m, 0.0) * _MISSING_SHARE
    tells = bool(max(seen_m) > _TELLING_M)
    return Shape(center, size, yaw, float(_SURE_M + missing[0]), float(_SURE_M + missing[1]), tells)


def _completed(points: Float64, label: str, eye_m: Float64, top_m: float) -> tuple[Float64, Float64, float]:
    length, width, height, spread = SIZES[label or "car"]
    xy = np.ascontiguousarray(points[:: 1 + len(points) // _ENOUGH, :2])
    rectangle = fit_rectangles(xy, np.array([0, len(xy)]), HEADINGS_RAD, NEAR_M)
    whole = complete(rectangle, eye_m, VehicleSize(length, width, height))
    high = max(top_m, height) if spread > 0.3 else height
    return whole.center_m[0], np.array([*whole.size_lw_m[0], high]), float(whole.yaw_rad[0])


def _extents(points: Float64, yaw_rad: float) -> Float64:
    """Length and width (2,) of what is seen [m]."""
    if not len(points):
        return np.zeros(2)
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    along, across = points[:, 0] * cos + points[:, 1] * sin, points[:, 1] * cos - points[:, 0] * sin
    return np.array([np.ptp(along), np.ptp(across)])
