"""Brightness and color of video (Y'CbCr) to BGR, in whole numbers, so that every machine gives the same."""

import numpy as np

from fbench.replay.data.arrays import Array
from fbench.replay.geometry.kernels import kernel

BITS = 21  # Of the fraction: the largest sum of two parts still fits 32 bits


@kernel
def mix_colors(y: Array, cb: Array, cr: Array, steps: tuple[int, int], factors: Array, out: Array) -> None:
    """Write (H, 3 W) BGR of planes (H, W) and smaller ones, whose samples hold for `steps` pixels across and down.

    `factors` (7,) int32 are zero and factor of brightness, zero of color, then the factors of Cr in red, Cb and Cr in
    green, Cb in blue.
    """
    height, width = y.shape
    across, down = steps
    zero, of_light, middle, red_cr, green_cb, green_cr, blue_cb = factors
    few, shift_x = np.empty((3, cb.shape[1]), np.int32), 1 if across == 2 else 0
    blue, green, red = np.empty(width, np.int32), np.empty(width, np.int32), np.empty(width, np.int32)
    half, shift, low, high = np.int32(1 << (BITS - 1)), np.int32(BITS), np.int32(0), np.int32(255)
    for i in range(height):
        if i % down == 0:
            of_blue, of_red = cb[i // down], cr[i // down]
            for j in range(len(of_blue)):
                b, r = np.int32(of_blue[j]) - middle, np.int32(of_red[j]) - middle
                few[0, j], few[1, j], few[2, j] = blue_cb * b, green_cb * b + green_cr * r, red_cr * r
            for k in range(width):
                j = k >> shift_x
                blue[k], green[k], red[k] = few[0, j], few[1, j], few[2, j]
        line, target = y[i], out[i]
        for k in range(width):
            light = of_light * (np.int32(line[k]) - zero) + half
            target[3 * k] = np.uint8(min(max((light + blue[k]) >> shift, low), high))
            target[3 * k + 1] = np.uint8(min(max((light + green[k]) >> shift, low), high))
            target[3 * k + 2] = np.uint8(min(max((light + red[k]) >> shift, low), high))
