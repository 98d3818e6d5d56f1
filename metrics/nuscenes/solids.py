"""Boxes in space."""

from typing import NamedTuple

import numpy as np

from fbench.metrics.objects import Objects
from fbench.replay.arrays import Float64


class Solids(NamedTuple):
    """N boxes."""

    center_m: Float64
    """(N, 3)"""
    size_lwh_m: Float64
    """(N, 3)"""
    yaw_rad: Float64
    """(N,)"""


def solids(boxes: Objects) -> Solids:
    """Return what `check_sequence` has found to be there; no boxes, no solids."""
    center, size, yaw = boxes.center_m, boxes.size_lwh_m, boxes.yaw_rad
    if center is None or size is None or yaw is None:
        return Solids(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    return Solids(center, size, yaw)
