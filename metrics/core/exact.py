"""Sums that never round: floats added as fractions, and counts added field by field."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import cache
from typing import Any, Self

import numpy as np

from fbench.replay.data.arrays import Float64, Int64


@dataclass(frozen=True)
class Counts:
    """Base of dataclasses of numbers, tuples of numbers, other counts and mappings, which add field by field."""

    def __add__(self, other: Self) -> Self:
        return type(self)(*[_add(getattr(self, name), getattr(other, name)) for name in _names_of(type(self))])  # type: ignore[arg-type]


@cache
def _names_of(kind: type[Counts]) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind))


def _add(one: Any, other: Any) -> Any:
    if isinstance(one, tuple):
        return tuple(map(_add, one, other))
    if isinstance(one, Mapping):
        return {**one, **{key: one[key] + more if key in one else more for key, more in other.items()}}
    return one + other


def exact_sum(values: Float64) -> Fraction:
    """Return the sum of finite values (N,) without rounding."""
    return fractions(exact_sums(values, np.zeros(len(values), np.int64), 1))[0]


def exact_sums(values: Float64, row: Int64, num_rows: int) -> Int64:
    """Return the sums of the finite values (N,) of each row, as digits (num_rows, LIMBS); `row` (N,) says whose."""
    from fbench.metrics.core.sums_kernel import LIMBS, exact_digits  # numba takes a while to import

    digits = np.zeros((num_rows, LIMBS), np.int64)
    # Kernels are compiled for writeable arrays.
    exact_digits(np.require(values, np.float64, ["C", "W"]), np.require(row, np.int64, ["C", "W"]), digits)
    return digits


def fractions(digits: Int64) -> tuple[Fraction, ...]:
    """Return the numbers that `digits` (K, LIMBS) of a kernel stand for."""
    from fbench.metrics.core.sums_kernel import LIMBS, LOWEST

    tops = [0] * len(digits)
    rows, places = np.nonzero(digits)
    lowest = int(places.min(initial=LIMBS))
    values = digits[rows, places]
    for row, place, value in zip(rows.tolist(), places.tolist(), values.tolist(), strict=True):
        tops[row] += value << 32 * (place - lowest)
    shift = LOWEST - 32 * lowest
    return tuple(Fraction(top, 1 << shift) if shift > 0 else Fraction(top << -shift) for top in tops)
