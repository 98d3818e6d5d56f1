"""Assignment against scipy's, ties included, and exact sums against fractions."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from fbench.metrics.core.assignment_kernel import assign, best_places
from fbench.metrics.core.exact import exact_sum


def theirs(cost: np.ndarray) -> list[int]:
    column_of = np.full(len(cost), -1)
    rows, columns = linear_sum_assignment(cost)
    column_of[rows] = columns
    return column_of.tolist()


@pytest.mark.parametrize("values", [2, 3, 10, 1000])
def test_the_same_pairs_as_scipy_also_with_ties(values):
    rng = np.random.Generator(np.random.Philox(values))
    for _ in range(3000):
        cost = rng.integers(0, values, rng.integers(1, 9, 2)).astype(float)
        assert assign(cost, 0.0).tolist() == theirs(cost)


def test_the_same_pairs_as_scipy_on_sparse_reals():
    rng = np.random.Generator(np.random.Philox(7))
    for size in (3, 10, 40, 120):
        for _ in range(40):
            score = rng.random((size, rng.integers(1, 2 * size)))
            score[rng.random(score.shape) < 0.8] = 0
            assert assign(-score, 0.0).tolist() == theirs(-score)


def test_pairs_that_add_nothing_are_left_out_and_the_short_way_agrees_with_the_long_one():
    rng = np.random.Generator(np.random.Philox(8))
    for _ in range(2000):
        score = np.where(rng.random(rng.integers(1, 7, 2)) < 0.8, 0, rng.integers(1, 4))
        score = score.astype(float)
        expected = [j if j >= 0 and score[i, j] > 0 else -1 for i, j in enumerate(theirs(-score))]
        n, m = score.shape
        place = best_places(np.array([0, n]), np.array([0, m]), np.array([0, n * m]), score.ravel(), 0.0, 0.0)
        assert np.where(place < 0, -1, place - m * np.arange(n)).tolist() == expected


def test_no_rows_or_no_columns():
    assert assign(np.zeros((0, 3)), 0.0).tolist() == []
    assert assign(np.zeros((2, 0)), 0.0).tolist() == [-1, -1]


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False)))
def test_sums_are_exact(values):
    assert exact_sum(np.array(values, float)) == sum(map(Fraction, values), Fraction(0))


@given(st.lists(st.floats(0, 1)), st.integers(0, 30))
def test_sums_in_parts_are_bit_equal_to_the_whole(values, cut):
    array = np.array(values, float)
    assert exact_sum(array[:cut]) + exact_sum(array[cut:]) == exact_sum(array[::-1])
