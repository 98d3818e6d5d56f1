"""Clusters as boxes, along the axes or turned, and which are dropped."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbench.pipelines.baseline.boxes import (
    box_clusters,
    cluster_in_space,
    cluster_pixels,
    crop,
    fit_headings,
    iou,
    join_clouds,
    make_cloud,
    members,
    to_solid,
)
from fbench.pipelines.baseline.params import PlainClusterParams, PlainCropParams, PlainImageParams, PlainSizeParams
from fbench.replay.data.boxes import Source

ANY = PlainSizeParams(1, 0.0, 100.0, 100.0, 0.0, 100.0)
PAIR = PlainClusterParams(eps_m=1.0, min_points=2)
LINE = np.array([[10.0, 0, 1], [10.8, 0.6, 1.2], [30, 0, 1], [10.4, 0.2, 0.6]])


def box(length, width, height, num=20, x=10.0):
    """Points that fill a box: its corners, and others inside."""
    shares = np.linspace(0, 1, num)
    return np.column_stack([x + length * shares, width * shares, 0.5 + height * shares])


def test_which_points_take_part():
    xyz = np.array([[3, 0, 1.0], [2.9, 0, 1], [0, 100, 1], [0, 100.1, 1], [9, 0, 0.3], [9, 0, 0.29], [9, 0, 3.5],
                    [9, 0, 3.51]])  # fmt: skip
    np.testing.assert_array_equal(crop(make_cloud(xyz, Source.L), PlainCropParams()).xyz, xyz[[0, 2, 4, 6]])


def test_a_box_is_the_extent_of_a_cluster():
    points = make_cloud(LINE, Source.R, np.array([3.0, np.nan, 9.0, 5.0]))
    found = box_clusters(points, cluster_in_space(points, PAIR), LINE, ANY)
    np.testing.assert_array_equal(found.low, [[10, 0, 0.6]])
    np.testing.assert_array_equal(found.high, [[10.8, 0.6, 1.2]])
    np.testing.assert_allclose(found.distance_m, [np.sqrt(10.4**2 + 0.3**2 + 0.9**2)])
    assert found.range_rate_mps.tolist() == [4.0]
    assert (found.score.tolist(), found.sources.tolist(), found.label.tolist()) == ([1.0], [Source.R], [""])


def test_height_tells_clusters_apart():
    """x, y and z count: what is over another, too."""
    above = LINE + np.array([0, 0, 3.0])
    points = make_cloud(np.concatenate([LINE, above]), Source.L)
    assert cluster_in_space(points, PAIR).tolist() == [0, 0, -1, 0, 1, 1, -1, 1]


def test_in_an_image_depth_tells_clusters_apart():
    uv = np.array([[100.0, 50], [104, 50], [102, 52], [101, 51]])
    params = PlainImageParams(eps_px=10, min_points=2, depth_px_per_m=5)
    assert cluster_pixels(uv, np.array([20.0, 20, 30, 30]), params).tolist() == [0, 0, 1, 1]
    assert cluster_pixels(uv, np.array([20.0, 20, 21, 21]), params).tolist() == [0, 0, 0, 0]
    assert cluster_pixels(uv, np.array([20.0, 20, 90, 30]), params).tolist() == [0, 0, -1, -1]


def test_outlines_are_of_places_while_sizes_are_judged_in_space():
    uv = np.column_stack([np.arange(4.0), np.arange(4.0) * 2])
    found = box_clusters(make_cloud(LINE, Source.L), np.array([0, 0, -1, 0]), uv, ANY)
    np.testing.assert_array_equal(np.column_stack([found.low, found.high]), [[0, 0, 3, 6]])
    none = box_clusters(make_cloud(LINE, Source.L), np.array([0, 0, -1, 0]), uv, PlainSizeParams(least_points=4))
    assert none.low.shape == (0, 2)


@pytest.mark.parametrize(
    ("shape", "num", "kept"),
    [
        ((4.0, 1.8, 1.5), 20, True),
        ((1.8, 4.0, 1.5), 20, True),  # across the way
        ((4.0, 1.8, 1.5), 10, True),
        ((4.0, 1.8, 1.5), 9, False),
        ((1.0, 0.2, 1.5), 20, True),
        ((0.9, 0.9, 1.5), 20, False),
        ((12.0, 6.0, 1.5), 20, True),
        ((12.1, 2.0, 1.5), 20, False),
        ((8.0, 6.1, 1.5), 20, False),
        ((4.0, 1.8, 0.25), 20, False),
        ((4.0, 1.8, 2.9), 20, True),
        ((4.0, 1.8, 3.1), 20, False),
    ],
)
def test_sizes_of_vehicles(shape, num, kept):
    length, width, height = shape
    xyz = box(length, width, height, num)
    limits = PlainSizeParams(10, 1.0, 12.0, 6.0, 0.3, 3.0)
    assert len(box_clusters(make_cloud(xyz, Source.L), np.zeros(num, np.int64), xyz, limits)) == kept


def test_sources_of_a_merged_cloud():
    both = join_clouds(
        [
            make_cloud(LINE[:1], Source.L),
            make_cloud(LINE[1:2], Source.R, np.array([2.0])),
            make_cloud(LINE[2:], Source.S),
        ]
    )
    found = box_clusters(both, cluster_in_space(both, PAIR), both.xyz, ANY)
    assert found.sources.tolist() == [Source.L | Source.R | Source.S]
    assert found.range_rate_mps.tolist() == [2.0]


def test_nothing_at_all():
    empty = join_clouds([])
    assert len(box_clusters(empty, cluster_in_space(empty, PAIR), empty.xyz, ANY)) == 0
    assert box_clusters(empty, cluster_pixels(np.zeros((0, 2)), np.zeros(0), PlainImageParams()), np.zeros((0, 2)),
                 ANY).low.shape == (0, 2)  # fmt: skip
    far = make_cloud(LINE, Source.L)
    assert len(box_clusters(far, cluster_in_space(far, PlainClusterParams(0.01, 2)), LINE, ANY)) == 0


def test_members():
    assert [rows.tolist() for rows in members(np.array([1, -1, 0, 1]))] == [[2], [0, 3]]
    assert members(np.array([-1, -1])) == members(np.zeros(0, np.int64)) == []


@given(st.integers(0, 2**32 - 1))
def test_the_order_of_points_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    xyz, rate = rng.normal(0, 2, (60, 3)), rng.normal(0, 5, 60)
    order = rng.permutation(60)
    a, b = make_cloud(xyz, Source.R, rate), make_cloud(xyz[order], Source.R, rate[order])
    first, second = (box_clusters(c, cluster_in_space(c, PlainClusterParams(0.8, 3)), c.xyz, ANY) for c in (a, b))
    for name in ("low", "high", "distance_m", "range_rate_mps", "sources"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def l_shape(yaw, x=20.0, y=5.0):
    """The rear, 1.8 m, and the side, 4 m, of a car that heads in a direction: no two of its corners are diagonal."""
    side, rear = np.linspace(0, 4, 21), np.linspace(0.1, 1.8, 18)
    xy = np.concatenate([np.column_stack([side, 0 * side]), np.column_stack([0 * rear, rear])])
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    xy = xy @ turn.T + [x, y]
    return np.column_stack([xy, np.linspace(0.5, 1.5, len(xy))])


@pytest.mark.parametrize("degrees", [0, 25, 60, 90, 120, -45])
def test_a_turned_box_lies_along_the_sides_of_its_cluster(degrees):
    yaw = np.radians(degrees)
    xyz = l_shape(yaw)
    found = box_clusters(make_cloud(xyz, Source.L), np.zeros(len(xyz), np.int64), xyz, ANY, oriented=True)
    solid = to_solid(found)
    center = np.array([20, 5]) + np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]) @ [2, 0.9]
    np.testing.assert_allclose(solid.center_m, [[*center, 1.0]], atol=0.05)
    np.testing.assert_allclose(solid.size_lwh_m, [[4, 1.8, 1]], atol=0.08)
    assert np.sin(solid.yaw_rad[0] - yaw) == pytest.approx(0, abs=0.03)
    np.testing.assert_allclose(found.distance_m, np.linalg.norm(solid.center_m, axis=1))


def test_points_on_a_line_and_single_points_have_a_heading():
    line, point = np.array([[1.0, 1], [2, 2], [3, 3]]), np.array([[1.0, 1]])
    assert fit_headings(line, [np.arange(3)]) == pytest.approx([np.pi / 4], abs=0.02)
    assert len(fit_headings(point, [np.arange(1)])) == 1
    assert len(fit_headings(point, [])) == 0


def test_headings_dont_depend_on_the_order_of_points():
    xy = np.random.Generator(np.random.Philox(3)).normal(0, [3, 1], (40, 2))
    assert fit_headings(xy, [np.arange(40)]) == fit_headings(xy[::-1], [np.arange(40)])


def test_turned_boxes_overlap_as_rectangles():
    """Two of 4 x 1.8 m at one place, at right angles: they share 1.8 x 1.8 of 2 x 7.2 - 3.24 m^2."""
    one, other = (
        box_clusters(make_cloud(xyz, Source.L), np.zeros(len(xyz), np.int64), xyz, ANY, oriented=True)
        for xyz in (l_shape(0.0), l_shape(np.pi / 2, 22.9, 3.9))
    )
    np.testing.assert_allclose(iou(one, other), [[3.24 / (14.4 - 3.24)]], rtol=1e-4)
