"""Detections in an order that their content alone decides, so that tracks don't depend on how they were listed."""

import numpy as np

from fbench.pipelines.tracking.columns import Columns, rows
from fbench.replay.arrays import Array, Bool
from fbench.replay.boxes import MAX_MAGNITUDE


def canonical(detections: Columns, place: str) -> Columns:
    """Return sound detections by rising `place` (N, ...), equal ones by all that they carry.

    Those whose place, size, heading or score isn't finite are left out: nothing can be tracked by them.
    """
    if not len(detections[place]):
        return detections
    good = _sound(detections, place)
    detections = detections if good.all() else rows(detections, good)
    if len(detections[place]) < 2:
        return detections
    order = np.lexsort(detections[place].T[::-1])
    ordered = detections[place][order]
    if (ordered[1:] == ordered[:-1]).all(axis=1).any():
        order = np.lexsort([key for name in sorted(detections) for key in _keys(detections[name])])
    return rows(detections, order)


def _sound(detections: Columns, place: str) -> Bool:
    named = [detections[name] for name in (place, "size_lwh_m", "yaw_rad", "score") if name in detections]
    limit = [np.abs(array).reshape(len(array), -1).max(axis=1) < MAX_MAGNITUDE for array in named]
    return np.asarray(np.logical_and.reduce(limit), np.bool_)


def _keys(array: Array) -> list[Array]:
    return [array] if array.ndim == 1 else list(array.T)
