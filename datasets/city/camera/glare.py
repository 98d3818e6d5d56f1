"""Glare: what lens and sensor spread around very bright lights."""

import numpy as np

from fbench.replay.arrays import Array, Float32
from fbench.replay.kernels import kernel

SHRINK = 4
"""Glare is smooth: it is computed at a quarter of the image's width and height."""


def glare_of(image: Float32, radius_px: float) -> Float32:
    """Return what is brighter than white (1) in an image (H, W, 3), spread around: (H/4, W/4, 3), rounded up.

    A narrow halo holds most of it, a wide one the rest.
    """
    over, found = _excess(image)
    if not found:
        return over
    narrow = _spread(over, max(1, round(radius_px / SHRINK)))
    wide = _spread(narrow, max(2, round(4 * radius_px / SHRINK)))
    return np.asarray(np.float32(0.7) * narrow + np.float32(0.3) * wide, np.float32)


@kernel
def _excess(image: Array) -> tuple[Array, bool]:
    height, width = image.shape[:2]
    over = np.zeros(((height + SHRINK - 1) // SHRINK, (width + SHRINK - 1) // SHRINK, 3), np.float32)
    found = False
    for v in range(height):
        for u in range(width):
            for c in range(3):
                if image[v, u, c] > 1:
                    over[v // SHRINK, u // SHRINK, c] += (image[v, u, c] - 1) / (SHRINK * SHRINK)
                    found = True
    return over, found


@kernel
def _spread(image: Array, radius: int) -> Array:
    """Blur by three running means, almost a Gaussian."""
    for _ in range(3):
        image = mean_across(mean_across(image, radius), radius)
    return image


@kernel
def mean_across(image: Array, radius: int) -> Array:
    """Average over pixels side by side; the result is turned, so that the second time goes along the other axis."""
    height, width, channels = image.shape
    result = np.empty((width, height, channels), np.float32)
    for v in range(height):
        for c in range(channels):
            total = 0.0
            for u in range(-radius, width):
                if u + radius < width:
                    total += image[v, u + radius, c]
                if u - radius - 1 >= 0:
                    total -= image[v, u - radius - 1, c]
                if u >= 0:
                    result[u, v, c] = max(0.0, total) / (2 * radius + 1)
    return result
