"""Kernels on points against plain references, written down independently, on random inputs.

DBSCAN as a whole is compared in `test_dbscan.py`, deskewing in `test_deskew.py`.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fbench.pipelines.sensors.lidar.classification import measure_inside
from fbench.pipelines.sensors.points import dbscan as grids
from fbench.pipelines.sensors.points.grid import (
    cell_bounds,
    cell_numbers,
    cells_of,
    lexicographic,
    may_touch,
    row_starts,
)
from fbench.pipelines.sensors.points.ground import best_bands, heights, lowest_rows
from fbench.pipelines.sensors.points.vehicle import fit_rectangles
from fbench.pipelines.sensors.radar.doppler import agreement

seeds = st.integers(0, 2**32 - 1)
often = settings(deadline=None, max_examples=150)
at_times = settings(deadline=None, max_examples=100)


def scattered(rng, num, num_axes):
    """Points, some equal and some on a grid."""
    points = rng.normal(0, rng.uniform(0.1, 20, num_axes), (num, num_axes))
    return np.round(points * 2) / 2 if rng.random() < 0.3 else points


# --- rectangles


def plain_rectangle(xy, headings, near_m):
    """The first of the best headings: closeness summed over points, then the outline there, and the mean distance."""
    found = []
    for heading in headings:
        c, s = np.cos(heading), np.sin(heading)
        u, v = xy[:, 0] * c + xy[:, 1] * s, xy[:, 1] * c - xy[:, 0] * s
        edges = np.array([u - u.min(), u.max() - u, v - v.min(), v.max() - v]).min(axis=0)
        closeness = (1 / np.maximum(edges, near_m)).sum()
        found.append((closeness, [heading, u.min(), u.max(), v.min(), v.max(), edges.mean()]))
    return found


@pytest.mark.slow
@often
@given(seeds, st.integers(1, 4))
def test_rectangles(seed, num_clusters):
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 30, num_clusters)
    xy = scattered(rng, sizes.sum(), 2)
    first = np.concatenate([[0], np.cumsum(sizes)])
    headings = np.radians(np.arange(0, 90, rng.integers(1, 30)))
    found = fit_rectangles(xy, first, headings, 0.05)
    for m in range(num_clusters):
        plain = plain_rectangle(xy[first[m] : first[m + 1]], headings, 0.05)
        closeness, _ = plain[headings.tolist().index(found[m, 0])]
        assert closeness >= max(one for one, _ in plain) * (1 - 1e-9)  # sums are added in another order
        expected = {row[0]: row for _, row in plain}[found[m, 0]]
        np.testing.assert_allclose(found[m], expected, rtol=1e-9, atol=1e-9)


def test_the_first_of_equally_good_headings_wins():
    one = np.array([[3.0, 4.0]])
    assert fit_rectangles(one, np.array([0, 1]), np.array([0.5, 0.0, 0.2]), 0.05)[0, 0] == 0.5


# --- points in rectangles


@often
@given(seeds)
def test_points_inside_rectangles(seed):
    rng = np.random.default_rng(seed)
    points = scattered(rng, int(rng.integers(1, 60)), 3)
    num = int(rng.integers(1, 6))
    low = rng.normal(0, 5, (num, 2))
    high, heading = low + rng.uniform(0, 10, (num, 2)), rng.uniform(-4, 4, num)
    margin_m = float(rng.choice([0.0, 0.5]))
    rectangles = np.column_stack([heading, low[:, 0], high[:, 0], low[:, 1], high[:, 1]])
    found = measure_inside(points, rectangles, margin_m)
    for m in range(num):
        c, s = np.cos(heading[m]), np.sin(heading[m])
        u, v = c * points[:, 0] + s * points[:, 1], c * points[:, 1] - s * points[:, 0]
        along = (u > low[m, 0] - margin_m) & (u < high[m, 0] + margin_m)
        inside = along & (v > low[m, 1] - margin_m) & (v < high[m, 1] + margin_m)
        assert found[m].tolist() == [inside.sum(), points[inside, 2].max(initial=-np.inf)]


# --- Doppler


@often
@given(seeds, st.sampled_from([0.0, 0.5, 10.4]))
def test_agreement_of_velocities(seed, period):
    rng = np.random.default_rng(seed)
    num = int(rng.integers(0, 40))
    direction, velocity = rng.normal(size=(num, 3)), rng.normal(0, 15, num)
    direction[rng.random(num) < 0.1, 0] = 0.0
    forward, sideways, band = np.sort(rng.uniform(-5, 45, 6)), rng.uniform(-2, 2, 3), float(rng.uniform(0.05, 2))
    left = velocity + forward[:, None, None] * direction[:, 0] + sideways[:, None] * direction[:, 1]
    if period:
        left = np.remainder(left + period / 2, period) - period / 2
    expected = np.maximum(0.0, 1 - np.abs(left) / band).sum(axis=2)
    found = agreement(direction, velocity, forward, sideways, period, band)
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7)


# --- the ground


@at_times
@given(seeds, st.sampled_from([0.0, 0.05, 0.5]))
def test_lowest_point_of_each_cell(seed, outliers):
    rng = np.random.default_rng(seed)
    num = int(rng.integers(1, 200))
    cell, z = rng.integers(-4, 4, (num, 2)), np.round(rng.normal(0, 1, num), 1)
    expected = []
    for own in np.unique(cell, axis=0):
        rows = np.flatnonzero((cell == own).all(axis=1))
        expected.append(sorted(rows, key=lambda row: (z[row], row))[int(outliers * len(rows))])
    assert lowest_rows(cell, z, outliers).tolist() == expected


@at_times
@given(seeds)
def test_best_band(seed):
    rng = np.random.default_rng(seed)
    z = np.sort(np.round(rng.normal(0, 1, (3, int(rng.integers(1, 30)))), 1), axis=1)
    lower = np.sort(z + rng.choice([0.0, 0.3, 0.7], z.shape), axis=1)
    num, begin = best_bands(z, lower, 0.5)
    for row in range(3):
        within = [int((z[row, at:] <= z[row, at] + 0.5).sum()) for at in range(z.shape[1])]
        below = [int((lower[row] < z[row, at]).sum()) for at in range(z.shape[1])]
        expected = [w - 2 * b for w, b in zip(within, below, strict=True)]
        assert (num[row], begin[row]) == (max(expected), expected.index(max(expected)))


@at_times
@given(seeds)
def test_heights_above_a_surface(seed):
    rng = np.random.default_rng(seed)
    num = int(rng.integers(0, 60))
    xyz, near, plane = scattered(rng, num, 3), rng.random(num) < 0.7, rng.normal(0, 1, 3)
    surface, cell = rng.normal(0, 1, (5, 7)), rng.integers(0, 5, (int(near.sum()), 2))
    expected = xyz[:, 2] - (plane[0] * xyz[:, 0] + plane[1] * xyz[:, 1] + plane[2])
    expected[near] -= surface[cell[:, 0], cell[:, 1]]
    np.testing.assert_array_equal(heights(xyz, near, cell, plane, surface), expected)


# --- the grid of DBSCAN


@pytest.mark.slow
@often
@given(seeds)
def test_cells_and_their_bounds(seed):
    rng = np.random.default_rng(seed)
    num = int(rng.integers(1, 60))
    rows = np.column_stack([scattered(rng, num, 3), rng.uniform(0.1, 1, num)])
    level, edge = rng.integers(0, 3, num), 0.5
    numbers = cell_numbers(rows, level, edge)
    expected = [
        (int(n), *(int(np.floor(x / (edge * 2.0**n))) for x in p)) for p, n in zip(rows[:, :3], level, strict=True)
    ]
    assert [tuple(one) for one in numbers.tolist()] == expected
    order = lexicographic(numbers)
    assert order.tolist() == sorted(range(num), key=lambda i: (expected[i], i))
    points, cells, first = cells_of(rows, numbers, order)
    np.testing.assert_array_equal(points, rows[order])
    assert [tuple(one) for one in cells.tolist()] == sorted(set(expected))
    assert first.tolist() == [*(sorted(expected).index(one) for one in sorted(set(expected))), num]
    starts = [i for i, one in enumerate(cells.tolist()) if i == 0 or one[:3] != cells[i - 1, :3].tolist()]
    assert row_starts(cells).tolist() == [*starts, len(cells)]
    bounds, is_small = cell_bounds(points, first)
    for c in range(len(cells)):
        own = points[first[c] : first[c + 1]]
        low, high = own[:, :3].min(axis=0), own[:, :3].max(axis=0)
        least, most = own[:, 3].min(), own[:, 3].max()
        np.testing.assert_array_equal(bounds[c], [*low, *high, most * most])
        x, y, z = high - low
        assert is_small[c] == (x * x + y * y + z * z <= least * least)


@pytest.mark.slow
@often
@given(seeds, st.sampled_from([1, 3, 4]))
def test_lexicographic_order_of_any_numbers(seed, num_columns):
    rng = np.random.default_rng(seed)
    reach = int(rng.choice([2, 5000, 2**50]))
    numbers = rng.integers(-reach, reach, (int(rng.integers(1, 60)), num_columns))
    np.testing.assert_array_equal(lexicographic(numbers), np.lexsort(numbers.T[::-1]))


@pytest.mark.slow
@often
@given(seeds)
def test_cells_may_touch_where_points_are_neighbors(seed):
    """As the distance of their bounds says, and so wherever two of their points are neighbors."""
    rng = np.random.default_rng(seed)
    clouds = [rng.uniform(0, 1, (int(rng.integers(1, 6)), 3)) + rng.integers(-2, 3, 3) for _ in range(2)]
    radius = rng.uniform(0.05, 3, 2)
    bounds = np.array([[*p.min(axis=0), *p.max(axis=0), r**2] for p, r in zip(clouds, radius, strict=True)])
    (low_a, low_b), (high_a, high_b) = bounds[:, :3], bounds[:, 3:6]
    gap = np.maximum(0, np.maximum(low_a - high_b, low_b - high_a))
    found = may_touch(bounds, 0, 1)
    assert found == (gap[0] * gap[0] + gap[1] * gap[1] + gap[2] * gap[2] <= bounds[:, 6].min())
    nearest = np.linalg.norm(clouds[0][:, None] - clouds[1], axis=2).min()
    assert found or nearest > radius.min()


@at_times
@given(seeds, st.integers(1, 3))
def test_pairs_of_cells_are_all_that_may_touch_each_once(seed, num_axes):
    """Of one level and of several: compared with all pairs of cells."""
    rng = np.random.default_rng(seed)
    num = int(rng.integers(1, 80))
    points = np.zeros((num, 4))
    points[:, 3 - num_axes : 3] = scattered(rng, num, num_axes)
    points[:, 3] = rng.choice([0.3, 0.5, 1.1, 5.0], num) if rng.random() < 0.5 else 0.7
    least = points[:, 3].min()
    level = np.frexp(points[:, 3] / least)[1].astype(np.int64) - 1
    edge = least / np.sqrt(num_axes) * 0.999
    _, _, cells, _, bounds = grids._grid(points, cell_numbers(points, level, edge))
    found = [tuple(sorted(pair)) for pair in grids._pairs(cells, bounds, edge).tolist()]
    expected = [(a, b) for b in range(len(cells)) for a in range(b) if may_touch(bounds, a, b)]
    assert len(found) == len(set(found))
    assert sorted(found) == sorted(expected)


@pytest.mark.parametrize("num", [0, 1])
def test_of_nothing(num):
    assert fit_rectangles(np.zeros((num, 2)), np.arange(num + 1), np.array([0.0]), 0.05).shape == (num, 6)
    assert measure_inside(np.zeros((num, 3)), np.zeros((0, 5)), 0.0).shape == (0, 2)
    assert agreement(np.zeros((num, 3)), np.zeros(num), np.zeros(1), np.zeros(1), 0.0, 1.0).shape == (1, 1)
