"""Value noise: numbers that depend on a place alone."""

from math import floor

import numpy as np

from fbench.replay.arrays import Array, Float32
from fbench.replay.kernels import kernel

_SIDE = 128
"""After so many values smooth noise repeats itself; sums of octaves hide it."""
_LAST = _SIDE - 1


def _mixed(h: Array) -> Array:
    """Turn whole numbers (N,) into others that look random."""
    h = ((h ^ (h >> 15)) * 2246822519) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 3266489917) & 0xFFFFFFFF
    return np.asarray(h ^ (h >> 16))


def _values() -> Float32:
    number = _mixed(np.arange(1, _SIDE * _SIDE + 1, dtype=np.int64) * 73856093 & 0xFFFFFFFF)
    return np.asarray((number & 0xFFFFFF) * (2.0 / 0xFFFFFF) - 1.0, np.float32)


_VALUES = _values()


@kernel
def hashed(x: int, y: int, salt: int) -> float:
    """Return a number from -1 to 1 that belongs to two whole numbers and a salt."""
    h = (x * 73856093) ^ (y * 19349663) ^ (salt * 83492791)
    h = ((h ^ (h >> 15)) * 2246822519) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 3266489917) & 0xFFFFFFFF
    h ^= h >> 16
    return (h & 0xFFFFFF) * (2.0 / 0xFFFFFF) - 1.0


@kernel
def value_noise(u: float, v: float, salt: int) -> float:
    """Return smooth noise from -1 to 1 with one value a unit square."""
    x, y = floor(u), floor(v)
    a, b = u - x, v - y
    a, b = a * a * (3 - 2 * a), b * b * (3 - 2 * b)
    i, j = int(x) + salt * 37, int(y) + salt * 59
    left, right = i & _LAST, (i + 1) & _LAST
    lower, upper = (j & _LAST) * _SIDE, ((j + 1) & _LAST) * _SIDE
    low = _VALUES[lower + left] * (1 - a) + _VALUES[lower + right] * a
    high = _VALUES[upper + left] * (1 - a) + _VALUES[upper + right] * a
    return float(low * (1 - b) + high * b)


@kernel
def fractal_noise(u: float, v: float, octaves: int, salt: int) -> float:
    """Return noise with details: every octave is twice as fine and half as strong; within -2 to 2."""
    total, weight = 0.0, 1.0
    for octave in range(octaves):
        total += weight * value_noise(u, v, salt + octave)
        u, v, weight = 2.03 * u + 7.1, 2.03 * v - 3.7, 0.5 * weight
    return total
