import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sklearn.cluster import DBSCAN

from fbench.pipelines.sensors.points.dbscan import dbscan
from fbench.replay.contracts.errors import ConfigError


@st.composite
def clouds(draw):
    # Multiples of 1/4 keep all squared distances exact, so that the closed ball has no rounding at its rim.
    shape = (draw(st.integers(1, 60)), draw(st.integers(1, 3)))
    origin = draw(st.sampled_from([0.0, 1e6, -1e6]))
    return draw(arrays(np.int64, shape, elements=st.integers(-12, 12))) / 4.0 + origin


eps = st.sampled_from([0.25, 0.5, 0.75, 1.25])
min_points = st.integers(1, 6)


def same_partition(a, b):
    pairs = set(zip(a.tolist(), b.tolist(), strict=True))
    return len(pairs) == len({i for i, _ in pairs}) == len({j for _, j in pairs})


def require_agreement_with_scikit_learn(points, eps, min_points):
    expected = DBSCAN(eps=eps, min_samples=min_points).fit(points)
    labels = dbscan(points, eps, min_points)
    core = expected.core_sample_indices_
    assert same_partition(labels[core], expected.labels_[core])
    np.testing.assert_array_equal(labels < 0, expected.labels_ < 0)


def plain_dbscan(points, radii, min_points):
    """All pairs, flood fill in lexicographic order, border points to the lowest number."""
    squared = np.zeros((len(points), len(points)))
    for axis in points.T:
        with np.errstate(over="ignore"):
            squared += (axis[:, None] - axis) ** 2
    near = squared <= np.minimum(radii[:, None], radii) ** 2
    core = near.sum(axis=1) >= min_points
    labels, number = np.full(len(points), -1), 0
    for seed in sorted(np.flatnonzero(core), key=lambda i: tuple(points[i])):
        if labels[seed] >= 0:
            continue
        waiting = [seed]
        labels[seed] = number
        while waiting:
            fresh = np.flatnonzero(near[waiting.pop()] & core & (labels < 0))
            labels[fresh] = number
            waiting.extend(fresh)
        number += 1
    for i in np.flatnonzero(~core):
        labels[i] = min(labels[core & near[i]], default=-1)
    return labels


@pytest.mark.slow
@settings(deadline=None, max_examples=100)
@given(clouds(), eps, min_points)
def test_core_points_and_noise_are_those_of_scikit_learn(points, eps, min_points):
    require_agreement_with_scikit_learn(points, eps, min_points)


@pytest.mark.slow
@pytest.mark.parametrize("num_axes", [1, 2, 3])
def test_hundreds_of_clouds_of_all_densities_agree_with_scikit_learn(num_axes):
    rng = np.random.Generator(np.random.Philox(num_axes))
    for _ in range(250):
        num = int(rng.integers(1, 120))
        points = rng.normal(0, rng.uniform(0.1, 4, num_axes), (num, num_axes)) + rng.choice([0, 5e4])
        points = np.concatenate([points, points[: num // 5], points[: num // 8] + 0.3])
        require_agreement_with_scikit_learn(points, rng.uniform(0.05, 1.5), int(rng.integers(1, 9)))


@settings(deadline=None)
@given(clouds(), eps, min_points, st.randoms(use_true_random=False))
def test_order_of_points_changes_nothing(points, eps, min_points, random):
    order = list(range(len(points)))
    random.shuffle(order)
    np.testing.assert_array_equal(dbscan(points[order], eps, min_points), dbscan(points, eps, min_points)[order])


@settings(deadline=None, max_examples=100)
@given(clouds(), eps, min_points)
def test_numbers_and_border_points_are_those_of_the_plain_definition(points, eps, min_points):
    expected = plain_dbscan(points, np.full(len(points), eps), min_points)
    np.testing.assert_array_equal(dbscan(points, eps, min_points), expected)


@pytest.mark.slow
@settings(deadline=None, max_examples=100)
@given(clouds(), st.data(), min_points)
def test_radius_for_each_point_is_that_of_the_plain_definition(points, data, min_points):
    radii = np.array(data.draw(st.lists(st.sampled_from([0.25, 0.75, 1, 1.75, 6]), min_size=60, max_size=60)))
    radii = radii[: len(points)]
    np.testing.assert_array_equal(dbscan(points, radii, min_points), plain_dbscan(points, radii, min_points))


@pytest.mark.parametrize("num_axes", [1, 2, 3])
def test_radius_that_grows_with_distance_is_that_of_the_plain_definition(num_axes):
    rng = np.random.Generator(np.random.Philox(num_axes))
    for _ in range(300):
        points = rng.normal(0, 1, (int(rng.integers(1, 150)), num_axes)) * rng.lognormal(1, 1.5)
        radii = rng.uniform(0.02, 0.6) * np.maximum(1, np.linalg.norm(points, axis=1) / rng.uniform(0.1, 3))
        least = int(rng.integers(1, 9))
        np.testing.assert_array_equal(dbscan(points, radii, least), plain_dbscan(points, radii, least))


def test_border_point_between_two_clusters():
    left, right = np.array([[0.0], [0.1], [0.2]]), np.array([[1.8], [1.9], [2.0]])
    points = np.concatenate([right, [[1.0]], left])
    assert dbscan(points, 0.85, 4).tolist() == [1, 1, 1, 0, 0, 0, 0]


def test_the_smaller_of_two_radii_counts():
    points = np.array([[0.0], [1.0], [2.5]])
    assert dbscan(points, np.array([1.0, 2.0, 2.0]), 2).tolist() == [0, 0, 0]
    assert dbscan(points, np.array([0.9, 2.0, 2.0]), 2).tolist() == [-1, 0, 0]


@pytest.mark.parametrize(("count", "expected"), [(0, []), (1, [-1]), (2, [-1, -1]), (3, [0, 0, 0])])
def test_few_and_equal_points(count, expected):
    assert dbscan(np.full((count, 3), 7.0), 0.5, 3).tolist() == expected


@pytest.mark.parametrize("direction", [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 2.0, 2.0]])
def test_points_on_a_line_exactly_a_radius_apart(direction):
    step = np.array(direction)  # of length 1 or 3
    points = np.arange(500)[:, None] * step
    length = float(np.linalg.norm(step))
    assert np.all(dbscan(points, length, 3) == 0)
    assert np.all(dbscan(points, np.nextafter(length, 0), 2) == -1)


def test_coordinates_far_out():
    points = np.array([[1e30, 0.0], [1e30, 0.0], [-1e300, 0.0]])
    assert dbscan(points, 0.5, 2).tolist() == [0, 0, -1]


def test_far_out_where_numbers_are_no_finer_than_the_radius():
    rng = np.random.Generator(np.random.Philox(1))
    for far, eps in [(2.0**52, 3.0), (2.0**53, 2.0), (1e30, 0.5), (2.0**50, 0.75), (1e300, 1e299)]:
        points = np.concatenate([far + rng.integers(0, 12, (60, 2)) * np.spacing(far), rng.normal(0, 1, (40, 2))])
        np.testing.assert_array_equal(dbscan(points, eps, 3), plain_dbscan(points, np.full(100, min(eps, 1e150)), 3))


@pytest.mark.parametrize("eps", [5e-324, 1e-300, 1e300, float("inf")])
def test_radii_at_the_ends_of_what_numbers_hold(eps):
    points = np.array([[0.0, 0.0], [0.0, 0.0], [3.0, 0.0]])
    assert dbscan(points, eps, 2).tolist() == [0, 0, -1 if eps < 1 else 0]
    assert dbscan(points, np.array([eps, eps, 1.0]), 2).tolist() == [0, 0, -1]


def test_points_that_are_not_finite_are_noise():
    points = np.array([[0.0, np.nan], [0.0, 0.0], [np.inf, 0.0], [0.0, 0.1], [np.inf, 0.0]])
    assert dbscan(points, 1.0, 2).tolist() == [-1, 0, -1, 0, -1]
    assert dbscan(points, np.full(5, 1.0), 2).tolist() == [-1, 0, -1, 0, -1]


def test_a_wide_range_of_radii_at_one_place():
    radii = 10.0 ** np.arange(-140, 140, 10)
    points = np.zeros((len(radii), 3))
    assert np.all(dbscan(points, radii, len(radii)) == 0)


@pytest.mark.slow
@pytest.mark.parametrize("spread_m", [0.0, 0.1, 100.0])
def test_a_million_points(spread_m):
    points = np.random.Generator(np.random.Philox(3)).normal(0, spread_m, (1_000_000, 3))
    labels = dbscan(points, 0.6, 4)
    if spread_m < 1:
        assert np.all(labels == 0)
    assert labels.min() >= -1


@pytest.mark.parametrize(("eps", "min_points"), [(0.0, 1), (-1.0, 1), (float("nan"), 1), (1.0, 0)])
def test_bad_parameters(eps, min_points):
    with pytest.raises(ConfigError, match=r"expected eps > 0 and min_points >= 1"):
        dbscan(np.zeros((3, 2)), eps, min_points)
