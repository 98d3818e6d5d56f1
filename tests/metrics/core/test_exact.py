"""Exact sums against fractions of the standard library."""

from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fbench.metrics.core.exact import exact_sum, exact_sums, fractions

FINITE = st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(FINITE, max_size=20))
def test_a_sum_is_that_of_fractions(values: list[float]) -> None:
    assert exact_sum(np.array(values, float)) == sum(map(Fraction, values))


def test_values_that_floats_would_lose_are_kept() -> None:
    assert exact_sum(np.array([1e300, 5e-324, -1e300])) == Fraction(5e-324)
    assert exact_sum(np.array([1e16, 1.0, -1e16])) == 1


@given(st.lists(st.tuples(st.integers(0, 3), FINITE), max_size=20))
def test_rows_are_added_apart(pairs: list[tuple[int, float]]) -> None:
    rows, values = np.array([r for r, _ in pairs], np.int64), np.array([v for _, v in pairs], float)
    found = fractions(exact_sums(values, rows, 4))
    assert list(found) == [sum((Fraction(v) for r, v in pairs if r == row), Fraction(0)) for row in range(4)]
