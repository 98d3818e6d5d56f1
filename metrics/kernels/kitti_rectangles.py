"""Compiled share of rectangles that regions cover."""

import numpy as np

from fbench.replay.arrays import Float64, Int64
from fbench.replay.kernels import kernel


@kernel
def covered_shares(boxes: Float64, start: Int64, regions: Float64, region_start: Int64) -> Float64:
    """Largest share (N,) of each rectangle's area that one region of its step covers; boxes (N, 4), regions (R, 4)."""
    shares = np.empty(len(boxes))
    for s in range(len(start) - 1):
        for i in range(start[s], start[s + 1]):
            shares[i], area = 0.0, (boxes[i, 2] - boxes[i, 0]) * (boxes[i, 3] - boxes[i, 1])
            for r in range(region_start[s], region_start[s + 1]):
                width = min(boxes[i, 2], regions[r, 2]) - max(boxes[i, 0], regions[r, 0])
                height = min(boxes[i, 3], regions[r, 3]) - max(boxes[i, 1], regions[r, 1])
                if width > 0.0 and height > 0.0:  # False where a rectangle isn't known
                    shares[i] = max(shares[i], width * height / area)
    return shares
