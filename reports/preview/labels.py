"""Judges whether 3D truth lies where LiDARs see something."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Bool, Float64
from fbench.replay.boxes import Boxes3D
from fbench.reports.preview.sample import Sample

_NEAR_M, _FAR_M = 25.0, 150.0
"""Nearer boxes should hold points, unless they are hidden; nobody labels what is farther away."""
_MIDDLE, _WIDER_M = 0.3, 0.5
"""Points count in this share of a box's height above and below its middle, so that the ground doesn't, and that far
beside it, since the vehicle moves during a sweep."""
_SIDE_RAD = 0.1
_FEW, _MIN_SHARE = 5, 0.5


@dataclass(frozen=True)
class Labels:
    """What is found."""

    text: str
    is_bad: bool


def judged(samples: Sequence[Sample]) -> Labels | None:
    """Count the boxes that hold points, among those near the body in whose direction a LiDAR sees something."""
    pairs = [(_labelled(s), _points(s)) for s in samples]
    away = [np.hypot(boxes.center_m[:, 0], boxes.center_m[:, 1]) for boxes, _ in pairs if len(boxes)]
    if away and (nearest := float(np.min(np.concatenate(away)))) > _FAR_M:
        num = sum(len(part) for part in away)
        text = f"the nearest of {num} boxes is {nearest:.0f} m away: wrong coordinate frame, or poses of another one?"
        return Labels(text, True)
    hit = np.concatenate([np.zeros(0, np.bool_), *(_hits(boxes, xyz) for boxes, xyz in pairs)])
    if len(hit) < _FEW:
        return None
    text = f"{int(hit.sum())} of {len(hit)} boxes within {_NEAR_M:g} m hold LiDAR points above the ground"
    is_bad = bool(hit.mean() <= _MIN_SHARE)
    return Labels(text + (": wrong coordinate frame, stamps or sizes?" if is_bad else ""), is_bad)


def _labelled(sample: Sample) -> Boxes3D:
    truth = sample.truth
    if truth is None or truth.boxes3d is None or truth.in_world:
        return Boxes3D(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    boxes = truth.boxes3d
    return boxes if boxes.ignore is None else boxes[~boxes.ignore]


def _points(sample: Sample) -> Float64:
    return np.concatenate([np.zeros((0, 3)), *(points.xyz for points in sample.placed("lidar"))])


def _hits(boxes: Boxes3D, xyz: Float64) -> Bool:
    """Whether points are inside, of each box that can be judged."""
    azimuth, found = np.arctan2(xyz[:, 1], xyz[:, 0]), []
    for center, size, yaw in zip(boxes.center_m, boxes.size_lwh_m, boxes.yaw_rad, strict=True):
        beside = np.abs(np.angle(np.exp(1j * (azimuth - np.arctan2(center[1], center[0]))))) < _SIDE_RAD
        if np.hypot(center[0], center[1]) < _NEAR_M and beside.any():
            x, y, z = (xyz - center).T
            ahead, left = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
            inside = (np.abs(ahead) < size[0] / 2 + _WIDER_M) & (np.abs(left) < size[1] / 2 + _WIDER_M)
            found.append(bool(np.any(inside & (np.abs(z) < _MIDDLE * size[2]))))
    return np.array(found, np.bool_)
