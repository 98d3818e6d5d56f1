"""Brightness and color of video (Y'CbCr) to BGR, in whole numbers, so that every machine gives the same."""

import numpy as np

from fbench.replay.data.arrays import Array
from fbench.replay.geometry.kernels import kernel

BITS = 16  # Of the fraction of factors


@kernel
def mix_colors(y: Array, cb: Array, cr: Array, steps: tuple[int, int], factors: Array, out: Array) -> None:
    """Write (H, W, 3) BGR of planes (H, W) and smaller ones, whose samples hold for `steps` pixels across and down.

    `factors` are zero and factor of brightness, zero of color, then those of Cr in red, Cb and Cr in green, Cb in blue.
    """
    y_zero, of_y, zero, red_cr, green_cb, green_cr, blue_cb = factors
    half = 1 << (BITS - 1)
    across, down = steps
    for i in range(y.shape[0]):
        row = i // down
        for j in range(cb.shape[1]):
            blue_part = np.int32(cb[row, j]) - zero
            red_part = np.int32(cr[row, j]) - zero
            blue = blue_cb * blue_part
            green = green_cb * blue_part + green_cr * red_part
            red = red_cr * red_part
            for k in range(j * across, min((j + 1) * across, y.shape[1])):
                light = of_y * (np.int32(y[i, k]) - y_zero) + half
                out[i, k, 0] = min(max((light + blue) >> BITS, 0), 255)
                out[i, k, 1] = min(max((light + green) >> BITS, 0), 255)
                out[i, k, 2] = min(max((light + red) >> BITS, 0), 255)
