"""What clusters of a LiDAR are: boxes with scores, by the fitted model or by rules for passenger cars."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.points.car_shape import CarShapeParams, plausibility
from fbench.pipelines.points.features import FEATURES, Standing, features
from fbench.pipelines.points.ground import Plane
from fbench.pipelines.points.road_users import fitted_model
from fbench.pipelines.points.vehicle import OtherSizes, VehicleSize, complete
from fbench.replay.arrays import Float64, Int64
from fbench.replay.boxes import Boxes3D

_TOP = FEATURES.index("top_m")
_HIGHEST_M = 4.5
"""No road user is higher [m]: what is seen above that is a tree or a bridge."""


@dataclass(frozen=True, eq=False)
class Seen:
    """Clusters of one frame, M of them."""

    standing: Standing
    """Their points, and those beside and above them."""
    rectangles: Float64
    """(M, 6) as `fit_rectangles` gives them."""
    plane: Plane
    """The ground."""
    viewpoint: Float64
    """(2,) where the LiDAR is [m]."""


def like_cars(seen: Seen, size: VehicleSize, shape: CarShapeParams) -> Boxes3D:
    """Complete clusters to cars; the score says how much they look like one, in [0, 1]."""
    first = seen.standing.first
    height = seen.standing.xy_height[first[0] :, 2]
    bottom, top = (part.reduceat(height, first[:-1] - first[0]) for part in (np.minimum, np.maximum))
    score = plausibility(seen.rectangles, np.diff(first), bottom, top, seen.standing.tall, shape)
    return _completed(seen, np.zeros(len(top), np.int64), (size,), top, score)


def road_users(seen: Seen, car: VehicleSize, others: OtherSizes) -> Boxes3D:
    """Complete clusters to road users of the likeliest class; the score is the probability of any class."""
    model = fitted_model()
    found = features(seen.standing, seen.rectangles)
    probability = model.probabilities(found)
    kind = np.argmax(probability, axis=1)
    by_label = {"car": car, "van": others.van, "truck": others.truck, "motorcycle": others.motorcycle,
                "bicycle": others.bicycle, "pedestrian": others.pedestrian}  # fmt: skip
    sizes = tuple(by_label[label] for label in model.labels.tolist())
    boxes = _completed(seen, kind, sizes, np.minimum(found[:, _TOP], _HIGHEST_M), probability.sum(axis=1))
    score = _one_at_a_place(boxes)
    return Boxes3D(boxes.center_m, boxes.size_lwh_m, boxes.yaw_rad, label=model.labels[kind], score=score)


def _one_at_a_place(boxes: Boxes3D) -> Float64:
    """Scores (M,), each times the probability that none of the likelier boxes around its middle is there.

    Where two parts of one vehicle are two clusters, both are completed to all of it. Of equal scores the first counts.
    """
    score = np.zeros(0) if boxes.score is None else boxes.score
    offset = boxes.center_m[:, None, :2] - boxes.center_m[None, :, :2]
    cos, sin = np.cos(boxes.yaw_rad), np.sin(boxes.yaw_rad)
    along = np.abs(offset[..., 0] * cos + offset[..., 1] * sin)
    across = np.abs(offset[..., 1] * cos - offset[..., 0] * sin)
    inside = (along < boxes.size_lwh_m[:, 0] / 2) & (across < boxes.size_lwh_m[:, 1] / 2)
    order = np.arange(len(score))
    likelier = (score > score[:, None]) | ((score == score[:, None]) & (order < order[:, None]))
    return np.asarray(score * np.prod(np.where(inside & likelier, 1.0 - score, 1.0), axis=1), np.float64)


def _completed(
    seen: Seen, kind: Int64, sizes: tuple[VehicleSize, ...],
    top_m: Float64, score: Float64,
) -> Boxes3D:  # fmt: skip
    """Complete clusters (M,) of each kind to its size."""
    num = len(kind)
    center, size, yaw = np.zeros((num, 3)), np.zeros((num, 3)), np.zeros(num)
    for number, typical in enumerate(sizes):
        rows = kind == number
        footprint = complete(seen.rectangles[rows], seen.viewpoint, typical)
        height = np.maximum(top_m[rows], typical.height_m)
        z = seen.plane.z_m(footprint.center_m) + height / 2
        center[rows] = np.column_stack([footprint.center_m, z])
        size[rows] = np.column_stack([footprint.size_lw_m, height])
        yaw[rows] = footprint.yaw_rad
    return Boxes3D(center, size, yaw, score=np.clip(score, 0.0, 1.0))
