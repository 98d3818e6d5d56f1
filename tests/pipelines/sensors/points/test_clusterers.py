import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fbench.pipelines.sensors.image.params import ImageClusterParams, cluster_in_image
from fbench.pipelines.sensors.lidar.clusters import LidarClusterParams, LidarParams, detect, obstacles
from fbench.pipelines.sensors.points.clustering import METHODS, Grouping
from fbench.pipelines.variants.lidar import Lidar3DParams
from fbench.pipelines.variants.radar import Radar3DParams
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.settings import apply_settings

BLOBS = np.concatenate(
    [np.random.Generator(np.random.Philox(5)).normal(center, 0.15, (40, 2)) for center in ([9, 0], [0, 0], [4, 4])]
)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_three_blobs_in_lexicographic_order(method):
    found = Grouping(method, 1.0, 5).clusters(BLOBS, np.zeros(len(BLOBS)))
    for blob, number in ((0, 2), (1, 0), (2, 1)):
        labels = found[40 * blob : 40 * blob + 40]
        assert np.count_nonzero(labels == number) > 35
        assert set(labels.tolist()) <= {-1, number}


@st.composite
def clouds(draw):
    shape = (draw(st.integers(0, 25)), draw(st.integers(1, 3)))
    return draw(arrays(np.int64, shape, elements=st.integers(-6, 6))) / 4.0


@pytest.mark.slow
@settings(deadline=None, max_examples=60)
@given(clouds(), st.sampled_from(METHODS[1:]), st.integers(1, 5), st.randoms(use_true_random=False))
def test_order_of_points_changes_nothing(points, method, min_points, random):
    grouping, range_m = Grouping(method, 0.5, min_points), np.zeros(len(points))
    order = list(range(len(points)))
    random.shuffle(order)
    labels = grouping.clusters(points, range_m)
    np.testing.assert_array_equal(grouping.clusters(points[order], range_m), labels[order])
    numbers, sizes = np.unique(labels[labels >= 0], return_counts=True)
    assert numbers.tolist() == list(range(len(numbers)))
    assert np.all(sizes >= min_points)
    firsts = [min(map(tuple, points[labels == n])) for n in numbers]
    assert firsts == sorted(firsts)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("num", [0, 1, 2, 3, 4, 50])
def test_few_and_equal_points(method, num):
    labels = Grouping(method, 0.5, 3).clusters(np.full((num, 2), 7.0), np.zeros(num))
    assert len(labels) == num
    assert len(set(labels.tolist())) <= 1
    assert num >= 3 or np.all(labels == -1)


@pytest.mark.parametrize("method", METHODS)
def test_points_that_are_not_finite_are_noise(method):
    points = np.concatenate([BLOBS, [[np.nan, 0.0], [np.inf, 0.0]]])
    grouping = Grouping(method, 1.0, 5)
    expected = [*grouping.clusters(BLOBS, np.zeros(120)), -1, -1]
    np.testing.assert_array_equal(grouping.clusters(points, np.zeros(122)), expected)


def test_radius_grows_beyond_the_distance_that_is_set():
    grouping = Grouping("dbscan", 0.5, 2, adaptive_from_m=20.0)
    np.testing.assert_allclose(grouping.radii(np.array([0.0, 20.0, 40.0])), [0.5, 0.5, 1.0])
    points = np.array([[10.0, 0.0], [10.0, 0.8], [40.0, 0.0], [40.0, 0.8]])
    assert grouping.clusters(points, points[:, 0]).tolist() == [-1, -1, 0, 0]


def test_only_the_radius_of_dbscan_grows():
    points = np.column_stack([np.full(40, 60.0), np.linspace(0.0, 4.0, 40)])
    found = [Grouping("agglomerative", 0.5, 2, from_m).clusters(points, points[:, 0]) for from_m in (None, 20.0)]
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("name", ["lidar", "radar"])
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["method=hdbscn"], r"cluster.method: there is no 'hdbscn'; did you mean 'hdbscan'\?"),
        (["method=kmeans"], r"there is no 'kmeans'"),
        (["adaptive_from_m=0.5"], r"cluster.adaptive_from_m: expected between 1 and 10000, got 0.5"),
    ],
)
def test_refused_parameters(name, changes, message):
    params = {"lidar": Lidar3DParams, "radar": Radar3DParams}[name]()
    with pytest.raises(ConfigError, match=message):
        apply_settings(params, [f"{name}.cluster.{change}" for change in changes])


def test_depth_tells_objects_apart_that_share_a_place_in_the_image():
    uv_px = np.array([[100.0, 50.0], [102.0, 50.0], [101.0, 51.0]] * 2)
    depth_m = np.array([10.0, 10.1, 10.2, 30.0, 30.1, 30.2])
    params = ImageClusterParams(min_points=3)
    assert cluster_in_image(uv_px, depth_m, params).tolist() == [0, 0, 0, 1, 1, 1]
    flat = ImageClusterParams(min_points=3, with_depth=False)
    assert cluster_in_image(uv_px, depth_m, flat).tolist() == [0] * 6


def test_heights_count_on_request():
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-20, 20, 0.5), np.arange(-20, 20, 0.5)))
    ground = np.column_stack([x, y, np.zeros(len(x))])
    below, above = (np.column_stack([np.full(9, 10.0), np.arange(9) * 0.2, np.full(9, z)]) for z in (0.5, 2.2))
    xyz = np.concatenate([ground, below, above])
    for with_height, expected in ((False, 1), (True, 2)):
        params = LidarParams(cluster=LidarClusterParams(with_height=with_height))
        assert len(detect(obstacles(xyz, params), np.zeros(3), params).boxes) == expected


def test_threads_leave_the_filters_of_warnings_as_they_were():
    before, apart = list(warnings.filters), np.arange(40.0)[:, None] * np.array([100.0, 1.0])

    def often(_number: int) -> None:
        for _ in range(10):
            assert Grouping("optics", 1.0, 5).clusters(apart, np.zeros(len(apart))).max() == -1

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(often, range(4)))
    assert list(warnings.filters) == before
