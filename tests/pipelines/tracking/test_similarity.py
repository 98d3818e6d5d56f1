"""Similarities of boxes, against values by hand and plain references."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from fbench.pipelines.tracking.association import giou_2d, giou_3d, mahalanobis_nearness
from fbench.pipelines.tracking.kalman import PLACE, PLACE_VAR, begin
from fbench.pipelines.tracking.kernels import hull_areas
from fbench.replay.geometry.iou import common_areas, iou_2d


def box(x=0.0, y=0.0, z=0.0, length=4.0, width=2.0, height=1.5, yaw=0.0):
    return np.array([[x, y, z, length, width, height, yaw]])


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (box(), 1.0),
        (box(yaw=np.pi), 1.0),
        # Side by side: no overlap, union 16 of a hull of 16.
        (box(x=4.0), 0.0),
        # A gap as long as a box: union 16, hull 24.
        (box(x=8.0), -1 / 3),
        # Half of each overlaps: 8 / 24, and the hull is the union.
        (box(x=2.0), 1 / 3),
        # One above the other, a gap of its height between: union 2, hull 3.
        (box(z=3.0), -1 / 3),
        # A cross: 4 m2 in both of 12; the hull is an octagon of 16 - 4 * 0.5.
        (box(yaw=np.pi / 2), 4 / 12 - 2 / 14),
    ],
)
def test_giou_in_space(other, expected):
    assert giou_3d(box(), other)[0, 0] == pytest.approx(expected, abs=1e-12)
    assert giou_3d(other, box())[0, 0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("odd", [box(length=0.0), box(length=0.0, width=0.0), box(x=np.nan), box(height=np.inf)])
def test_giou_of_what_is_hardly_a_box(odd):
    both = np.concatenate([odd, box()])
    found = giou_3d(both, both)
    assert np.isfinite(found).all()
    assert (np.abs(found) <= 1).all()


def test_giou_of_nothing():
    nothing = np.zeros((0, 7))
    assert giou_3d(nothing, box()).shape == (0, 1)
    assert giou_3d(box(), nothing).shape == (1, 0)
    assert giou_2d(np.zeros((0, 4)), np.zeros((2, 4))).shape == (0, 2)


boxes = st.tuples(
    *[st.floats(-20, 20)] * 3, *[st.floats(0.1, 12)] * 3, st.floats(-7, 7)
).map(lambda row: np.array([row]))  # fmt: skip


def footprint(row):
    x, y, _, length, width, _, yaw = row[0]
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    local = signs * [length / 2, width / 2]
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    return local @ turn.T + [x, y]


@pytest.mark.slow
@given(boxes, boxes)
@settings(max_examples=100, deadline=None)
def test_hulls_as_scipy_has_them(a, b):
    area = ConvexHull(np.concatenate([footprint(a), footprint(b)]), qhull_options="QJ Pp").volume
    assert hull_areas(a, b)[0, 0] == pytest.approx(area, rel=1e-6, abs=1e-6)


@given(boxes, boxes)
@settings(max_examples=100, deadline=None)
def test_giou_is_the_same_both_ways_and_within_its_limits(a, b):
    there, back = giou_3d(a, b)[0, 0], giou_3d(b, a)[0, 0]
    assert there == pytest.approx(back, abs=1e-9)
    assert -1 <= there <= 1


def test_giou_in_images():
    a = np.array([[0.0, 0, 10, 10]])
    b = np.array([[0.0, 0, 10, 10], [10, 0, 20, 10], [20, 0, 30, 10], [5, 0, 15, 10], [3, 3, 3, 3]])
    # The last one has no area, and lies within the hull of the first.
    np.testing.assert_allclose(giou_2d(a, b), [[1, 0, -1 / 3, 1 / 3, 0]], atol=1e-12)


def test_distance_in_standard_deviations():
    states = begin(np.zeros((1, 3)), np.zeros((1, 3)), np.sqrt([8.0, 3.0, 0.0]), np.ones(3))
    measured = np.array([[0.0, 0, 0], [3, 0, 0], [0, 2, 0], [3, 2, 0], [0, 0, 4]])
    # Variances of what is expected: 9, 4 and 1.
    found = mahalanobis_nearness(states, measured, np.ones(3), 4.0)
    np.testing.assert_allclose(found, [[1, 0.75, 0.75, 1 - np.sqrt(2) / 4, 0]])


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_mahalanobis_as_written_down(seed):
    rng = np.random.default_rng(seed)
    states = rng.uniform(0.1, 5, (5, 4, 3))
    measured, std = rng.normal(size=(5, 3)), rng.uniform(0.1, 2, (5, 3))
    expected = np.empty((4, 5))
    for t in range(4):
        for m in range(5):
            apart = measured[m] - states[PLACE][t]
            spread = np.diag(states[PLACE_VAR][t] + std[m] ** 2)
            expected[t, m] = max(0.0, 1 - np.sqrt(apart @ np.linalg.inv(spread) @ apart) / 3)
    np.testing.assert_allclose(mahalanobis_nearness(states, measured, std, 3.0), expected, atol=1e-9)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=150, deadline=None)
def test_overlap_in_images_is_that_of_numpy_bit_by_bit(seed):
    rng = np.random.default_rng(seed)
    low = rng.normal(0, 50, (9, 2))
    rows = np.concatenate([low, low + rng.uniform(-5, 60, (9, 2))], axis=1)  # some are inside out
    rows[rng.random(rows.shape) < 0.05] = rng.choice([np.nan, np.inf, -np.inf, 0.0])
    with np.errstate(invalid="ignore"):
        expected = overlaps(rows[:5], rows[3:])
    np.testing.assert_array_equal(iou_2d(rows[:5], rows[3:]), expected)


def overlaps(a, b):
    """The formula in numpy."""
    common = common_areas(a, b)
    area_a, area_b = (np.maximum(r[:, 2] - r[:, 0], 0) * np.maximum(r[:, 3] - r[:, 1], 0) for r in (a, b))
    union = area_a[:, None] + area_b[None, :] - common
    return np.divide(common, union, out=np.zeros_like(common), where=union > 0)
