"""Perception horizon: hand-checked, against isotonic regression, and added over runs."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import isotonic_regression

from fbench.metrics.core.slices import ScoreKey
from fbench.metrics.detection.horizon import HORIZONS, RangeCounts, horizon_rows

KEY = ScoreKey("vehicle", "all", "bev 2 m", None, 3)


def counted(*boxes: tuple[float, int]) -> RangeCounts:
    range_m, hit = np.array(boxes, float).reshape(-1, 2).T
    return RangeCounts.of(range_m, hit.astype(bool))


def test_by_hand():
    """Sums of 100 hit - 80 after 5, 10, 19 and 30 m: 20, -40, 0 and 20, then less; the later 20 counts."""
    near = (5.0, 1), (9.5, 1), (10.0, 0), (18.2, 1), (19.0, 1)
    n = counted(*near, (30.0, 1), (31.0, 0), (44.0, 0), (45.0, 0))
    assert [n.horizon_m(percent) for percent in HORIZONS.values()] == [30, 30, 5]


def test_all_found_none_found_and_the_border():
    assert counted((3.0, 1), (49.1, 1), (50.0, 1)).horizon_m(90) == 50
    assert counted((0.0, 1)).horizon_m(50) == 1
    assert counted((3.0, 0), (7.0, 0)).horizon_m(50) == 0
    assert counted((3.0, 1), (7.0, 0)).horizon_m(50) == 3  # None are found at 7 m
    assert counted((3.0, 1), (6.5, 1), (7.0, 0)).horizon_m(50) == 7  # Half are


@given(st.lists(st.tuples(st.integers(1, 8), st.booleans()), min_size=1), st.sampled_from([*HORIZONS.values()]))
def test_it_is_where_isotonic_regression_crosses_the_level(boxes, percent):
    meters = sorted({meter for meter, _ in boxes})
    hits = [sum(hit for own, hit in boxes if own == meter) for meter in meters]
    nums = np.array([sum(own == meter for own, _ in boxes) for meter in meters], float)
    curve = isotonic_regression(hits / nums, weights=nums, increasing=False).x
    wanted = max((m for m, y in zip(meters, curve, strict=True) if y >= percent / 100 - 1e-9), default=0)
    assert counted(*((meter - 0.5, int(hit)) for meter, hit in boxes)).horizon_m(percent) == wanted


@given(st.lists(st.tuples(st.floats(0, 90), st.booleans())), st.integers(0, 5))
def test_parts_add_up(boxes, cut):
    whole, parts = counted(*boxes), counted(*boxes[:cut]) + counted(*boxes[cut:])
    assert parts == whole
    assert sum(whole.hits.values()) == sum(hit for _, hit in boxes)


def test_rows_and_why_there_are_none():
    rows = horizon_rows(counted((3.0, 1), (7.0, 0)), 2, KEY)
    assert {row.metric: row.value for row in rows} == dict.fromkeys(HORIZONS, 3)
    assert {row.unit for row in rows} == {"m"}
    assert rows[0].counts == {"gt": 2, "tp": 1, "frames": 3}
    assert {row.reason for row in horizon_rows(RangeCounts(), 0, KEY)} == {"no truth boxes"}
    unknown = RangeCounts.of(None, np.ones(4, bool))
    assert {row.reason for row in horizon_rows(unknown, 4, KEY)} == {"truth has no distances"}


def test_unknown_distances_are_left_out():
    n = RangeCounts.of(np.array([np.nan, 4.0]), np.array([True, True]))
    assert (dict(n.truth), dict(n.hits)) == ({4: 1}, {4: 1})
