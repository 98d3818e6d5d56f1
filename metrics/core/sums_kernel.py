"""Compiled sums: exact ones of reals, and sums of rows and columns rounded as numpy 2 rounds them."""

import math

import numpy as np

from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.geometry.kernels import kernel, kernel_part

LIMBS = 70  # Digits to the base 2^32 that hold every float64
LOWEST = 1126  # The last digit counts units of 2^-1126


@kernel_part
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


_LANES = 8
_MOST = 128  # Values that are added in lanes; of more, halves are added


@kernel
def block_sums(
    row_start: Int64, column_start: Int64, block_start: Int64, values: Float64, of_row: Float64, of_column: Float64
) -> None:
    """Fill in the sum of each row (N,) and of each column (M,) of its step.

    Sums differ in their last digit by the order in which they are added; where pairs are equally good, that decides.
    numpy adds rows in pairs, as they lie side by side in memory, and columns one row after the other.
    Offsets of steps are (S + 1,), `values` (B,) are row-major; `of_row` (N,) and `of_column` (M,) are all 0.
    """
    for step in range(len(row_start) - 1):
        first, other, b = row_start[step], column_start[step], block_start[step]
        n, m = row_start[step + 1] - first, column_start[step + 1] - other
        for i in range(n):
            of_row[first + i] = _in_pairs(values[b + i * m : b + i * m + m])
            for j in range(m):
                of_column[other + j] += values[b + i * m + j]
        if m == 1:  # then its one column lies side by side, too
            of_column[other] = _in_pairs(values[b : b + n])


@kernel_part
def _in_pairs(values: Float64) -> float:
    num = len(values)
    if num > _MOST:
        half = num // 2 - num // 2 % _LANES
        return _in_pairs(values[:half]) + _in_pairs(values[half:])
    whole, total = num - num % _LANES, 0.0
    if whole:
        lane = np.zeros(_LANES)
        for k in range(whole):
            lane[k % _LANES] += values[k]
        total = ((lane[0] + lane[1]) + (lane[2] + lane[3])) + ((lane[4] + lane[5]) + (lane[6] + lane[7]))
    for k in range(whole, num):
        total += values[k]
    return total
