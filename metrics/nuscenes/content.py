"""The order of boxes by what they are, so that the order in which they are given never decides."""

import numpy as np

from fbench.metrics.nuscenes.solids import solids
from fbench.metrics.objects import Objects
from fbench.replay.arrays import Array, Bool, Int64


def content_order(boxes: Objects) -> Int64:
    """Return the order (N,) by step, then centre x, y, z, yaw, size, score, velocity, label, attribute; never by id.

    nuscenes-devkit goes by the order in the file where this one decides: between equal scores, between truth boxes
    at equal distances, and between tracks that both want to go on with the same partner.
    """
    center, size, yaw = solids(boxes)
    order = np.lexsort((center[:, 0], boxes.step))
    if not _any_equal(center[order, 0], boxes.step[order]):
        return order
    keys: list[Array] = [boxes.step, *center.T, yaw, *size.T, boxes.score]
    if boxes.velocity_mps is not None:
        keys += [*boxes.velocity_mps.T]
    keys += [boxes.label] + ([] if boxes.attribute is None else [boxes.attribute])
    return np.lexsort(keys[::-1])


def _any_equal(x: Array, step: Array) -> bool:
    unordered: Bool = ~(x[1:] > x[:-1]) & (step[1:] == step[:-1])  # NaN counts as equal
    return bool(unordered.any())
