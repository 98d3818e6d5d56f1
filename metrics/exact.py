"""Sums of floats as fractions: what statistics hold, so that adding them never rounds."""

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from fbench.replay.arrays import Float64, Int64


def exact_sum(values: Float64) -> Fraction:
    """Return the sum of finite values (N,) without rounding."""
    from fbench.metrics.kernels.exact import exact_digits  # numba takes a while to import

    return fraction(exact_digits(np.ascontiguousarray(values, np.float64)))


def fraction(digits: Int64) -> Fraction:
    """Return the number that `digits` (LIMBS,) of a kernel stand for."""
    return fractions(digits[None])[0]


def fractions(digits: Int64) -> tuple[Fraction, ...]:
    """Return the numbers that `digits` (K, LIMBS) of a kernel stand for."""
    from fbench.metrics.kernels.exact import LIMBS, LOWEST

    tops = [0] * len(digits)
    rows, places = np.nonzero(digits)
    lowest = int(places.min(initial=LIMBS))
    values = digits[rows, places]
    for row, place, value in zip(rows.tolist(), places.tolist(), values.tolist(), strict=True):
        tops[row] += value << 32 * (place - lowest)
    shift = LOWEST - 32 * lowest
    return tuple(Fraction(top, 1 << shift) if shift > 0 else Fraction(top << -shift) for top in tops)


def plus(ones: Sequence[Fraction], others: Sequence[Fraction]) -> tuple[Fraction, ...]:
    """Add two lists element by element."""
    return tuple(a + b for a, b in zip(ones, others, strict=True))
