"""The fast order of rows against numpy's."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fbench.pipelines.sensors.points.grid import lexicographic_order, median

VALUES = st.sampled_from([-np.inf, -1.5, -0.0, 0.0, 1e-9, 2.0, np.inf, np.nan])


@given(st.lists(st.tuples(VALUES, VALUES, VALUES), max_size=30))
def test_order_with_many_ties(rows):
    columns = np.array(rows, np.float64).reshape(-1, 3).T
    assert lexicographic_order(*columns).tolist() == np.lexsort(columns[::-1]).tolist()


def test_order_with_few_ties():
    xyz = np.random.default_rng(5).normal(size=(3, 2000))
    xyz[0, ::7] = xyz[0, 3]
    assert lexicographic_order(*xyz).tolist() == np.lexsort(xyz[::-1]).tolist()


@given(st.lists(st.floats(-1e300, 1e300), min_size=1, max_size=40))
def test_median_is_that_of_numpy(values):
    assert median(np.array(values)) == np.median(values)
