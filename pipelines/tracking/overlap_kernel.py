"""Compiled overlap of rectangles in an image."""

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
