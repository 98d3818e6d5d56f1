"""Which boxes are boxes at all."""

import numpy as np

from fbench.metrics.objects import Objects
from fbench.metrics.profile import Likeness
from fbench.replay.arrays import Bool, Float64
from fbench.replay.boxes import MAX_MAGNITUDE
from fbench.replay.errors import MetricError


def is_valid(objects: Objects, likeness: Likeness) -> Bool:
    """Tell of which objects (N,) score and geometry are finite, and no size is negative (fault PRD001 of results).

    Raises:
        MetricError: where the objects lack what the likeness compares.
    """
    good: Bool = np.isfinite(objects.score)
    if not len(objects):
        return good
    if likeness == "iou2d":
        box = _known(objects.xyxy_px, "boxes in images")
        good &= _finite(box) & np.all(box[:, 2:] >= box[:, :2], axis=1)
        return good
    center, size = _known(objects.center_m, "3D boxes"), _known(objects.size_lwh_m, "3D boxes")
    yaw = _known(objects.yaw_rad, "3D boxes")[:, None]
    good &= _finite(np.hstack([center, size, yaw])) & np.all(size >= 0, axis=1)
    return good


def faults(objects: Objects, row: int, likeness: Likeness) -> list[str]:
    """Say what is wrong with one object that isn't valid."""
    found = [] if np.isfinite(objects.score[row]) else ["its score isn't finite"]
    if likeness == "iou2d":
        box = _known(objects.xyxy_px, "boxes in images")[row : row + 1]
        return found + ([] if _finite(box)[0] else ["its rectangle isn't finite"]) + (
            ["its right is left of its left, or its bottom above its top"] if (box[0, 2:] < box[0, :2]).any() else []
        )  # fmt: skip
    center, size = _known(objects.center_m, "3D boxes"), _known(objects.size_lwh_m, "3D boxes")
    yaw = _known(objects.yaw_rad, "3D boxes")[:, None]
    parts = (("centre", center), ("size", size), ("heading", yaw))
    found += [f"its {what} isn't finite" for what, values in parts if not _finite(values[row : row + 1])[0]]
    return found + (["its size is negative"] if (size[row] < 0).any() else [])


def _known(values: Float64 | None, what: str) -> Float64:
    if values is None:
        raise MetricError(f"there are no {what} to score")
    return values


def _finite(values: Float64) -> Bool:
    magnitude = np.abs(np.nan_to_num(values, nan=np.inf, posinf=np.inf, neginf=-np.inf))
    small: Bool = np.all(magnitude < MAX_MAGNITUDE, axis=1)
    return small
