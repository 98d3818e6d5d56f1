"""Boxes that can match: one class of one sample."""

import numpy as np

from fbench.metrics.nuscenes.counted import Side
from fbench.metrics.nuscenes.solids import solids
from fbench.replay.arrays import Float64, Int64


def sorted_groups(side: Side, num_classes: int, num_steps: int, by_score: bool = False) -> tuple[Int64, Int64]:
    """Return rows (N,) in the order of samples, then classes, and offsets (num_steps * num_classes + 1,) of groups.

    Within a group they keep the order of their content, or go by score, the best first, before that.
    """
    group = side.boxes.step * num_classes + side.kind
    keys = (_descending(side.boxes.score), group) if by_score else (group,)
    order = np.lexsort(keys).astype(np.int64)
    start = np.searchsorted(group[order], np.arange(num_steps * num_classes + 1)).astype(np.int64)
    return order, start


def centers_xy(side: Side) -> Float64:
    """Return centres (N, 2) in the ground plane [m]."""
    return np.ascontiguousarray(solids(side.boxes).center_m[:, :2])


def _descending(score: Float64) -> Float64:
    return np.where(np.isnan(score), -np.inf, -score)
