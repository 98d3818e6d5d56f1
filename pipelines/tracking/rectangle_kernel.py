"""Compiled: rectangles in an image, what is filtered of them, and how they overlap."""

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.kernels import kernel


@kernel
def overlaps(a: Float64, b: Float64) -> Float64:
    """Intersection over union (N, M) of rectangles (N, 4) and (M, 4), bit by bit as `iou_2d` computes it."""
    result = np.zeros((len(a), len(b)))
    for i in range(len(a)):
        area = max(a[i, 2] - a[i, 0], 0.0) * max(a[i, 3] - a[i, 1], 0.0)
        for j in range(len(b)):
            across = max(min(a[i, 2], b[j, 2]) - max(a[i, 0], b[j, 0]), 0.0)
            down = max(min(a[i, 3], b[j, 3]) - max(a[i, 1], b[j, 1]), 0.0)
            common = across * down
            union = area + max(b[j, 2] - b[j, 0], 0.0) * max(b[j, 3] - b[j, 1], 0.0) - common
            if union > 0.0:
                result[i, j] = common / union
    return result


@kernel
def as_measured(xyxy: Float64, least: float) -> Float64:
    """Centre x, y, area and aspect ratio (N, 4) of left, top, right, bottom (N, 4); sides are `least` at least."""
    result = np.empty((len(xyxy), 4))
    for i in range(len(xyxy)):
        # Not `max`, which may make a side of what isn't a number.
        across, down = np.maximum(xyxy[i, 2] - xyxy[i, 0], least), np.maximum(xyxy[i, 3] - xyxy[i, 1], least)
        result[i, 0], result[i, 1] = (xyxy[i, 0] + xyxy[i, 2]) / 2, (xyxy[i, 1] + xyxy[i, 3]) / 2
        result[i, 2], result[i, 3] = across * down, np.divide(across, down)
    return result


@kernel
def as_corners(measured: Float64) -> Float64:
    """Left, top, right, bottom (N, 4) of centre, area and aspect ratio (N, 4)."""
    result = np.empty((len(measured), 4))
    for i in range(len(measured)):
        x, y, area, aspect = measured[i, 0], measured[i, 1], measured[i, 2], measured[i, 3]
        across, down = np.sqrt(area * aspect) / 2, np.sqrt(np.divide(area, aspect)) / 2
        result[i, 0], result[i, 1], result[i, 2], result[i, 3] = x - across, y - down, x + across, y + down
    return result
