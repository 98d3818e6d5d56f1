"""Compiled loops over the pixels of images, which give new arrays."""

import math

import numpy as np

from fbench.replay.data.arrays import Array, Float32, Float64
from fbench.replay.geometry.kernels import kernel


@kernel
def veil(values: Array, slope: Float32, offset: Float32, least: float, airlight: float) -> Array:
    """Return I t + L (1 - t) of values (3 N,) uint8, blue, green and red by turns, with the transmission t = slope gray
    + offset of each pixel (N,), at least `least` and at most 1; gray and airlight are 0 to 255.
    """
    result = np.empty_like(values)
    light, lowest, one = np.float32(airlight), np.float32(least), np.float32(1)
    for i in range(len(slope)):  # in one dimension, which compilers turn into vector instructions
        blue, green, red = np.int32(values[3 * i]), np.int32(values[3 * i + 1]), np.int32(values[3 * i + 2])
        gray = np.float32(blue + 2 * green + red) * np.float32(0.25)
        t = min(max(slope[i] * gray + offset[i], lowest), one)
        rest = light * (one - t) + np.float32(0.5)
        result[3 * i] = np.int32(np.float32(blue) * t + rest)
        result[3 * i + 1] = np.int32(np.float32(green) * t + rest)
        result[3 * i + 2] = np.int32(np.float32(red) * t + rest)
    return result


@kernel
def cover(values: Array, layer: Float32, blue: float, green: float, red: float) -> Array:
    """Return values (3 N,) uint8 behind a layer of one color (0 to 255) with an opacity (N,) of 0 to 1."""
    result = np.empty_like(values)
    color = (np.float32(blue), np.float32(green), np.float32(red))
    for i in range(len(layer)):
        for c in range(3):
            value = np.float32(values[3 * i + c])
            result[3 * i + c] = np.int32(value + layer[i] * (color[c] - value) + np.float32(0.5))
    return result


@kernel
def exchange(values: Array, table: Array, random: Array) -> Array:
    """Return for each value (N,) uint8 one of its row in `table` (256, 4096), chosen by 16 random bits."""
    result = np.empty_like(values)
    for i in range(len(values)):
        result[i] = table[values[i], random[i] >> 4]
    return result


@kernel
def brighten(values: Array, added: int) -> Array:
    """Return values (3 N,) uint8 with V of HSV, the largest of a pixel's three, raised by `added`; hue and saturation
    stay as far as white allows.
    """
    result = np.empty_like(values)
    for i in range(0, len(values), 3):
        most = max(int(values[i]), int(values[i + 1]), int(values[i + 2]))
        wanted = min(255, most + added)
        for c in range(i, i + 3):
            result[c] = wanted if most == 0 else (2 * values[c] * wanted + most) // (2 * most)
    return result


@kernel
def is_gray(values: Array) -> bool:
    """Tell whether values (3 N,) have no color; the first pixel that has decides."""
    i = 0
    while i < len(values) and values[i] == values[i + 1] == values[i + 2]:
        i += 3
    return i >= len(values)


@kernel
def draw_streaks(
    size_wh: tuple[int, int], start: Float64, along: Float64, length: Float64, wide: Float64, opacity: Float64
) -> Float32:
    """Return the opacity (H, W) of streaks that begin at `start` (N, 2) [px] and go down `length` (N,) along the unit
    vector `along` (2,): soft at their sides, faint at both ends; where several cross, what lies behind all of them.
    """
    width, height = size_wh
    clear = np.ones((height, width), np.float32)
    for n in range(len(start)):
        half = wide[n] / 2
        steps = int(length[n] * along[1]) + 1
        for step in range(steps):
            row = math.floor(start[n, 1]) + step
            if not 0 <= row < height:
                continue
            x = start[n, 0] + step * along[0] / along[1]
            fade = opacity[n] * math.sin(math.pi * (step + 0.5) / steps)
            first, last = math.floor(x - half), math.ceil(x + half)
            for column in range(max(first, 0), min(last, width - 1) + 1):
                inside = min(column + 0.5, x + half) - max(column - 0.5, x - half)
                if inside > 0:
                    clear[row, column] *= 1 - fade * inside
    return (1 - clear).astype(np.float32)
