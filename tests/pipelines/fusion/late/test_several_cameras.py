"""What several cameras see of one object is one object."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from tests.pipelines.fusion.views import AHEAD, K, car, lidar_view, radar_view

from fbench.pipelines.fusion.late.existence import FusionParams, join_cameras
from fbench.pipelines.fusion.late.fuse import SensorViews, fuse
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.geometry.camera import project_boxes

PLACES = {"left": 0.6, "middle": 0.0, "right": -0.6}
RIG = Rig(
    {name: Mount("camera", np.array([0.5, y, 0]), AHEAD) for name, y in PLACES.items()},
    dict.fromkeys(PLACES, CameraModel(K, (1280, 720))),
)
PARAMS = FusionParams(min_score=0.3)


def outline(camera, *cars, taller=1.0, label="car", score=0.8) -> CameraDetections:
    """Outlines of the near sides; `taller` ones look nearer than they are."""
    found = []
    for box in cars:
        size = box.size_lwh_m[0]
        side = Boxes3D(box.center_m - [size[0] / 2, 0, 0], np.array([[0.01, size[1], size[2]]]), box.yaw_rad)
        rectangle = project_boxes(RIG, camera, side)[0][0].copy()
        rectangle[1] = rectangle[3] - taller * (rectangle[3] - rectangle[1])
        found.append(rectangle)
    return CameraDetections(np.array(found).reshape(-1, 4), np.full(len(found), score), np.full(len(found), label))


def fused(cameras, lidar=None, radar=None):
    return fuse(SensorViews(RIG, cameras, lidar or lidar_view(plane=None), radar or radar_view()), PARAMS)


@pytest.mark.parametrize("names", [("left", "right"), ("left", "middle", "right")])
@pytest.mark.parametrize("sensors", ["camera", "lidar", "radar", "both"])
def test_one_car(names, sensors):
    box = car(25.0, 1.0)
    lidar = lidar_view(box) if sensors in ("lidar", "both") else None
    radar = radar_view(box) if sensors in ("radar", "both") else None
    found = fused({name: outline(name, box) for name in names}, lidar, radar)
    assert len(found) == 1
    assert found.sources.tolist() == [1 + 2 * (lidar is not None) + 4 * (radar is not None)]
    assert found.center_m[0, :2] == pytest.approx([25, 1], abs=0.5)


@pytest.mark.parametrize("names", [("middle",), ("left", "right"), ("left", "middle", "right")])
def test_every_camera_may_cut_a_car_out_of_a_tree(names):
    """One cluster of which two thirds are a tree beside the car; its box is that of both."""
    box = car(25.0, 1.0)
    found = fused({name: outline(name, box) for name in names}, in_a_tree(box))
    assert found.sources.tolist() == [3]
    assert found.center_m[0, :2] == pytest.approx([25, 1], abs=0.3)
    assert found.size_lwh_m[0, :2] == pytest.approx([4.2, 1.8], abs=0.2)
    assert found.score[0] > 0.7


def test_too_few_points_of_a_cluster_place_nothing():
    """Two of its points are in the camera's box: the car is where the camera guesses it, and of its usual size."""
    box = car(25.0, 1.0)
    few = in_a_tree(box)
    rows = np.append([0, 29], np.arange(30, 90))
    few = replace(few, xyz=few.xyz[rows], cluster=few.cluster[rows])
    found = fused({"middle": outline("middle", box)}, few)
    assert (found.size_lwh_m[:, 0] < 5).all()


def in_a_tree(box):
    """A LiDAR's view of a car whose points are in one cluster with those of a tree beside it."""
    view = lidar_view(box, score=0.0)
    tree = np.column_stack([np.linspace(22.9, 25.0, 60), np.linspace(2.2, 6.0, 60), np.linspace(-0.2, 1.0, 60)])
    whole = replace(view.boxes, center_m=np.array([[24.0, 3.0, 0.0]]), size_lwh_m=np.array([[4.2, 6.0, 2.5]]))
    return replace(view, xyz=np.concatenate([view.xyz, tree]), cluster=np.zeros(90, np.int64), boxes=whole)


def test_two_cars_in_one_cluster_keep_the_cameras_that_see_them():
    """Each camera's boxes cut out the same cluster; whose part comes first mustn't part the cameras of a car."""
    cars = car(25.0, 3.0), car(25.0, -3.0)
    views = [lidar_view(box, score=0.0) for box in cars]
    between = np.column_stack([np.full(60, 23.0), np.linspace(-2, 2, 60), np.zeros(60)])
    xyz = np.concatenate([*(view.xyz for view in views), between])
    whole = replace(views[0].boxes, center_m=np.array([[24.0, 0.0, 0.0]]), size_lwh_m=np.array([[4.2, 8.0, 1.6]]))
    joined = replace(views[0], xyz=xyz, cluster=np.zeros(len(xyz), np.int64), boxes=whole)
    found = fused({name: outline(name, *cars) for name in ("left", "right")}, joined)
    assert sorted(found.center_m[:, 1].tolist()) == pytest.approx([-3, 3], abs=0.4)
    assert found.sources.tolist() == [3, 3]


def test_cameras_are_not_independent_so_the_mean_of_their_odds_counts():
    box = car(25.0)
    found = fused({"left": outline("left", box, score=0.5), "right": outline("right", box, score=0.7)})
    odds = np.sqrt(0.5 / 0.5 * 0.7 / 0.3)
    assert found.score == pytest.approx([odds / (1 + odds)])


def test_one_opinion_told_thrice_counts_once_and_silence_by_its_share():
    """Objects that three cameras see, that one of three sees, that none sees, and that one sees and no other could."""
    seen = np.array([[True, True, False, True], [True, False, False, False], [True, False, False, False]])
    could = np.array([[1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 0.0], [1.0, 1.0, 1.0, 0.0]])
    joint = join_cameras(seen, np.where(seen, 2.0, -1.5), could)
    assert joint == pytest.approx([2.0, 2.0 - 1.5 * 2 / 3, -1.5, 2.0], abs=0.01)


def test_guesses_that_differ_along_the_line_of_sight_are_one_car():
    box = car(40.0, 2.0)
    apart = [fused({name: outline(name, box, taller=t)}).center_m[0, 0] for name, t in (("left", 1), ("right", 1.15))]
    assert abs(apart[0] - apart[1]) > 3.0
    assert len(fused({"left": outline("left", box), "right": outline("right", box, taller=1.15)})) == 1


@pytest.mark.parametrize("other", [car(20.0, -5.0), car(33.0, 2.5)])
def test_different_cars_stay_apart(other):
    box = car(20.0, 2.0)
    both = {name: outline(name, box, other) for name in PLACES}
    assert len(fused(both)) == 2
    assert len(fused({"left": outline("left", box), "right": outline("right", other)})) == 2


def test_two_boxes_of_one_camera_are_never_joined():
    near, beside = car(20.0, 1.0), car(20.0, -1.2)
    found = fused({name: outline(name, near, beside) for name in PLACES}, lidar_view(near, beside))
    assert sorted(found.center_m[:, 1]) == pytest.approx([-1.2, 1.0], abs=0.2)
    assert found.sources.tolist() == [3, 3]


def test_a_pedestrian_beside_a_car_that_another_camera_sees_stays():
    person, box = car(20.0, 2.0, size=(0.6, 0.6, 1.7)), car(21.0, 0.0)
    found = fused({"left": outline("left", person, label="pedestrian"), "right": outline("right", box)})
    assert sorted(found.label.tolist()) == ["car", "pedestrian"]


def test_result_does_not_depend_on_the_order_of_cameras():
    cars = car(15.0, -2.0), car(20.0, 2.0), car(33.0, 0.0)
    views = {name: outline(name, *cars) for name in PLACES}
    first = fused(views, lidar_view(*cars))
    turned = fused({name: views[name] for name in reversed(views)}, lidar_view(*cars))
    assert len(first) == 3
    for name, value in first.arrays().items():
        np.testing.assert_array_equal(value, turned.arrays()[name])
    assert all(a >= b for a, b in pairwise(first.score.tolist()))
