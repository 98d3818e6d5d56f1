import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sklearn.cluster import DBSCAN

from fbench.pipelines.points.dbscan import dbscan
from fbench.replay.errors import ConfigError


@st.composite
def clouds(draw):
    # Multiples of 1/4 keep all squared distances exact, so that the closed ball has no rounding at its rim.
    shape = (draw(st.integers(1, 60)), draw(st.integers(1, 3)))
    return draw(arrays(np.int64, shape, elements=st.integers(-12, 12))) / 4.0


eps = st.sampled_from([0.25, 0.5, 0.75, 1.25])
min_points = st.integers(1, 6)


def same_partition(a, b):
    pairs = set(zip(a.tolist(), b.tolist(), strict=True))
    return len(pairs) == len({i for i, _ in pairs}) == len({j for _, j in pairs})


@settings(deadline=None)
@given(clouds(), eps, min_points)
def test_core_points_and_noise_are_those_of_scikit_learn(points, eps, min_points):
    expected = DBSCAN(eps=eps, min_samples=min_points).fit(points)
    labels = dbscan(points, eps, min_points)
    core = expected.core_sample_indices_
    assert same_partition(labels[core], expected.labels_[core])
    np.testing.assert_array_equal(labels < 0, expected.labels_ < 0)


@settings(deadline=None)
@given(clouds(), eps, min_points, st.randoms(use_true_random=False))
def test_order_of_points_changes_nothing(points, eps, min_points, random):
    order = list(range(len(points)))
    random.shuffle(order)
    np.testing.assert_array_equal(dbscan(points[order], eps, min_points), dbscan(points, eps, min_points)[order])


@settings(deadline=None)
@given(clouds(), eps, min_points)
def test_clusters_are_numbered_by_their_smallest_core_point_and_border_points_go_low(points, eps, min_points):
    labels = dbscan(points, eps, min_points)
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    core = (distance <= eps).sum(axis=1) >= min_points
    smallest = [min(map(tuple, points[core & (labels == k)])) for k in range(labels.max() + 1)]
    assert smallest == sorted(smallest)
    for i in np.flatnonzero(~core & (labels >= 0)):
        assert labels[i] == labels[core & (distance[i] <= eps)].min()


def test_border_point_between_two_clusters():
    left, right = np.array([[0.0], [0.1], [0.2]]), np.array([[1.8], [1.9], [2.0]])
    points = np.concatenate([right, [[1.0]], left])
    assert dbscan(points, 0.85, 4).tolist() == [1, 1, 1, 0, 0, 0, 0]


@pytest.mark.parametrize(("count", "expected"), [(0, []), (1, [-1]), (2, [-1, -1]), (3, [0, 0, 0])])
def test_few_and_equal_points(count, expected):
    assert dbscan(np.full((count, 3), 7.0), 0.5, 3).tolist() == expected


def test_coordinates_far_out():
    points = np.array([[1e30, 0.0], [1e30, 0.0], [-1e300, 0.0]])
    assert dbscan(points, 0.5, 2).tolist() == [0, 0, -1]


@pytest.mark.parametrize(("eps", "min_points"), [(0.0, 1), (-1.0, 1), (float("nan"), 1), (1.0, 0)])
def test_bad_parameters(eps, min_points):
    with pytest.raises(ConfigError, match=r"expected eps > 0 and min_points >= 1"):
        dbscan(np.zeros((3, 2)), eps, min_points)
