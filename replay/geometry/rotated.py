"""Overlap of boxes with heading, seen from above."""

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes3D
from fbench.replay.geometry.boxes import distance_bev


def iou_bev(a: Boxes3D, b: Boxes3D) -> Float64:
    """Intersection over union (N, M) of the boxes' footprints, turned by yaw; roll and pitch are left out."""
    corners_a, corners_b = footprints(a), footprints(b)
    area_a, area_b = _areas(a), _areas(b)
    iou = np.zeros((len(a), len(b)))
    reach_a, reach_b = (np.hypot(boxes.size_lwh_m[:, 0], boxes.size_lwh_m[:, 1]) / 2 for boxes in (a, b))
    near = distance_bev(a.center_m, b.center_m) < reach_a[:, None] + reach_b[None, :]
    for i, j in np.argwhere(near):
        overlap = polygon_area(clip_convex(corners_a[i], corners_b[j]))
        union = area_a[i] + area_b[j] - overlap
        iou[i, j] = min(1.0, overlap / union) if union > 0 else 0.0
    return iou


def footprints(boxes: Boxes3D) -> Float64:
    """Corners (N, 4, 2) [m] of the boxes seen from above, counter-clockwise."""
    half = boxes.size_lwh_m[:, None, :2] / 2 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    cos, sin = np.cos(boxes.yaw_rad)[:, None], np.sin(boxes.yaw_rad)[:, None]
    x = cos * half[..., 0] - sin * half[..., 1]
    y = sin * half[..., 0] + cos * half[..., 1]
    return np.stack([x, y], axis=2) + boxes.center_m[:, None, :2]


def clip_convex(subject: Float64, window: Float64) -> Float64:
    """Intersection (K, 2) of two convex polygons, counter-clockwise (Sutherland and Hodgman, 1974)."""
    polygon = subject
    for start, end in zip(window, np.roll(window, -1, axis=0), strict=True):
        if not len(polygon):
            break
        polygon = _left_of(polygon, start, end)
    return polygon


def _left_of(polygon: Float64, start: Float64, end: Float64) -> Float64:
    """The part of a polygon to the left of the line from `start` to `end`."""
    edge = end - start
    side = edge[0] * (polygon[:, 1] - start[1]) - edge[1] * (polygon[:, 0] - start[0])
    kept = []
    for i in range(len(polygon)):
        before = i - 1
        if (side[i] >= 0) != (side[before] >= 0):
            share = side[before] / (side[before] - side[i])
            kept.append(polygon[before] + share * (polygon[i] - polygon[before]))
        if side[i] >= 0:
            kept.append(polygon[i])
    return np.array(kept).reshape(-1, 2)


def polygon_area(polygon: Float64) -> float:
    """Area of a polygon (K, 2), counter-clockwise (shoelace formula)."""
    if len(polygon) < 3:
        return 0.0
    x, y = (polygon - polygon[0]).T
    return max(0.0, float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2)


def _areas(boxes: Boxes3D) -> Float64:
    areas: Float64 = boxes.size_lwh_m[:, 0] * boxes.size_lwh_m[:, 1]
    return areas
