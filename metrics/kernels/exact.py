"""Sums of reals without rounding, so that they can be added in any order and grouping."""

import math

import numpy as np

from fbench.replay.arrays import Float64, Int64
from fbench.replay.kernels import kernel

LIMBS = 70
"""Digits to the base 2^32 that hold every float64."""
LOWEST = 1126
"""The last digit counts units of 2^-1126."""


@kernel
def add_exact(digits: Int64, value: float) -> None:
    """Add a finite `value` to the number that `digits` (LIMBS,) stand for, the last one first; 2^30 times at most."""
    if value == 0.0:
        return
    part, exponent = math.frexp(value)
    sign = 1 if part > 0 else -1
    whole = np.int64(abs(part) * 9007199254740992.0)
    place = exponent - 53 + LOWEST
    k, shift, mask = place // 32, place % 32, np.int64(0xFFFFFFFF)
    low, high = (whole & mask) << shift, (whole >> 32) << shift
    digits[k] += sign * (low & mask)
    digits[k + 1] += sign * ((low >> 32) + (high & mask))
    digits[k + 2] += sign * (high >> 32)


@kernel
def exact_digits(values: Float64, row: Int64, digits: Int64) -> None:
    """Add finite values (N,) to the rows (N,) of `digits` (K, LIMBS) that they belong to."""
    for i in range(len(values)):
        add_exact(digits[row[i]], values[i])
