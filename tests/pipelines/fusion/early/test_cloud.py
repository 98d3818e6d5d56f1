"""Which radar echoes join the points of LiDAR and stereo, and how much these count."""

import numpy as np
import pytest

from fbench.pipelines.fusion.early.cloud import (
    DepthView,
    EchoParams,
    find_dense_ground,
    merge_clouds,
)
from fbench.pipelines.sensors.lidar.clusters import Obstacles
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.radar.stage import Compensated
from fbench.pipelines.sensors.stereo.stage import find_unmeasured, rate_exactness
from fbench.replay.data.boxes import Source

NONE = Obstacles(None, np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
NAN = float("nan")


def echoes(rates, heights=None, strong=False) -> Compensated:
    num = len(rates)
    xyz = np.column_stack([np.full(num, 10.0), np.arange(num), np.ones(num) if heights is None else heights])
    zero = np.zeros(num)
    return Compensated(xyz, xyz, np.array(rates, float), zero, np.full(num, strong), zero)


def lidar(*heights: float) -> Obstacles:
    xyz = np.column_stack([np.full(len(heights), 5.0), np.zeros(len(heights)), np.array(heights)])
    return Obstacles(Plane(0.0, 0.0, 0.0), xyz, xyz[:, 2], np.zeros((0, 3)))


def test_an_echo_of_the_least_speed_moves():
    cloud = merge_clouds(DepthView(NONE, NONE, None), echoes([0.3, -0.3, 0.29, 0.0, NAN]), 0.3, EchoParams())
    assert cloud.is_moving.tolist() == [True, True, False, False]  # of unknown velocity only strong ones are used
    assert cloud.source.tolist() == [int(Source.R)] * 4


def test_strong_echoes_of_unknown_velocity_stand():
    cloud = merge_clouds(DepthView(NONE, NONE, None), echoes([NAN], strong=True), 0.3, EchoParams())
    assert cloud.is_moving.tolist() == [False]


def test_standing_echoes_are_as_high_as_objects_and_moving_ones_anywhere():
    view = DepthView(lidar(1.0, 1.5), NONE, Plane(0.0, 0.0, 0.0))
    heights = [0.2, 0.3, 0.31, 3.49, 3.5, 9.0]
    stands = merge_clouds(view, echoes([0.0] * 6, heights), 0.3, EchoParams())
    assert stands.height_m.tolist() == [1.0, 1.5, 0.31, 3.49]
    assert stands.source.tolist() == [int(Source.L)] * 2 + [int(Source.R)] * 2
    moves = merge_clouds(view, echoes([5.0] * 6, heights), 0.3, EchoParams())
    assert moves.height_m.tolist() == [1.0, 1.5, *heights]


def test_points_of_stereo_count_less_the_larger_their_error_of_depth_is():
    # 800 x 600, 90 degrees, halved: f = 200 px; with B = 0.4 m and 0.1 px the error is 0.125, 0.5 and 2 m.
    counts = rate_exactness(np.array([0.0, 10.0, 20.0, 40.0]), 80.0, 0.1)
    assert counts == pytest.approx([1.0, 1 / (1 + (0.125 / 0.3) ** 2), 1 / (1 + (0.5 / 0.3) ** 2), 0.09 / 4.09])
    view = DepthView(lidar(1.0), lidar(1.0, 1.5), None, exactness=counts[1:3])
    cloud = merge_clouds(view, echoes([5.0]), 0.3, EchoParams())
    assert cloud.exactness.tolist() == [1.0, *counts[1:3], 1.0]


def ray(azimuth_deg, elevation_deg, reach_m=20.0):
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    across = np.cos(elevation)
    return reach_m * np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)])


def test_stereo_tells_only_what_lidars_measure_nothing_of():
    """Whether the LiDAR's ray ends before or behind the place; beside it lies a cell of half a degree."""
    eye = np.array([2.0, 0.2, 1.0])
    measured = np.array([ray(0.25, 0.25, reach) for reach in (5.0, 50.0)]) + eye
    directions = [(0.25, 0.25), (0.75, 0.25), (0.25, -0.25), (1.25, 0.25), (0.25, 1.25), (180.0, 0.0)]
    places = np.array([ray(*direction) for direction in directions]) + eye
    assert find_unmeasured(places, measured, eye).tolist() == [False, False, False, True, True, True]
    assert find_unmeasured(places, np.zeros((0, 3)), eye).all()


def test_directions_go_on_behind_the_back():
    zero = np.zeros(3)
    assert not find_unmeasured(ray(-179.9, 0.25)[None], ray(179.9, 0.25)[None], zero).any()
    assert not find_unmeasured(np.array([[0, 0, 5.0]]), np.array([[0, 0, 9.0]]), zero).any()  # straight above


def test_only_dense_radars_show_the_ground():
    grid = np.stack(np.meshgrid(np.arange(5.0, 45.0, 0.5), np.arange(-15.0, 15.0, 0.4)), axis=-1).reshape(-1, 2)
    road, sign = np.column_stack([grid, np.full(len(grid), -1.0)]), np.array([[20.0, 0.0, 5.0]])
    xyz = np.concatenate([road, sign])
    zero = np.zeros(len(xyz))
    radar = Compensated(xyz, xyz, zero, zero, zero > 0, zero)
    plane, tall = find_dense_ground(radar, None, 5000)
    assert plane is not None
    assert tall is not None
    assert plane.z_m(np.array([[10.0, 2.0]])) == pytest.approx([-1.0], abs=0.05)
    assert tall.tolist() == sign.tolist()
    known = Plane(0.0, 0.0, -1.2)
    assert find_dense_ground(radar, known, 5000)[0] is known
    assert find_dense_ground(echoes([0.0] * 10), known, 5000) == (known, None)
