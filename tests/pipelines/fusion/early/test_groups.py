import numpy as np
import pytest
from tests.pipelines.frames import AHEAD
from tests.pipelines.fusion.early.clouds import L, R, joined, points
from tests.pipelines.scenes import car_back

from fbench.pipelines.fusion.early.groups import SemanticsParams, label_points
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.points.ground import Plane
from fbench.replay.data.rig import CameraModel, Mount, Rig

CAMERA = CameraModel(np.array([[500.0, 0, 399.5], [0, 500, 299.5], [0, 0, 1]]), (800, 600))
RIG = Rig({"cam": Mount("camera", np.zeros(3), AHEAD)}, {"cam": CAMERA})
GROUND = Plane(0.0, 0.0, -1.6)
BOX = [376.0, 300.0, 423.0, 340.0]
"""What a car looks like whose back is 20 m ahead: 1.8 m are 45 px there, 1.6 m are 40."""


def seen(*boxes, label="car", score=0.9):
    num = len(boxes)
    found = CameraDetections(np.array(boxes).reshape(-1, 4), np.full(num, score), np.array([label] * num, np.str_))
    return {"cam": found}


def wall(x_m):
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(-4, 4, 60), np.linspace(-1.2, 2, 12)))
    return np.column_stack([np.full(len(y), x_m), y, z])


def labeled(cloud, cameras):
    return label_points(RIG, cameras, cloud, GROUND, SemanticsParams())


def test_only_the_car_gets_the_label_not_what_stands_behind_it():
    car, behind = points(L, car_back(20.0, 0.0)), points(L, wall(30.0))
    cloud = joined(car, behind)
    found = labeled(cloud, seen(BOX))
    in_box = np.abs(cloud.xyz[:, 1] / cloud.xyz[:, 0]) < 0.04
    assert in_box[len(car) :].sum() > 50
    assert found.instance[: len(car)].sum() == -(~in_box[: len(car)]).sum()
    assert (found.instance[len(car) :] == -1).all()
    assert [s.label for s in found.observations] == ["car"]


def test_how_well_a_camera_would_see_a_car():
    """Where something stands before it, what a camera doesn't see may be there all the same."""
    cloud = joined(points(L, car_back(20.0, 0.0)), points(L, wall(30.0)), points(L, [[-9.0, 0, 0]]))
    height = labeled(cloud, seen(BOX)).height_px[36:]
    y, z = cloud.xyz[36:-1, 1:].T
    assert (height[:-1][(np.abs(y) < 1.2) & (z < 0)] == 0).all()
    assert height[:-1][np.abs(y) > 1.6] == pytest.approx(500 * 1.55 / 30, rel=0.02)
    assert height[-1] == 0


def test_nor_what_stands_before_it():
    pole = np.column_stack([np.full(30, 8.0), np.full(30, 0.0), np.linspace(-1.2, 0.5, 30)])
    cloud = joined(points(L, pole), points(L, car_back(20.0, 0.0)))
    found = labeled(cloud, seen(BOX))
    assert (found.instance[:30] == -1).all()
    assert (found.instance[30:] == 0).sum() > 25


def test_the_nearer_of_two_objects_takes_its_points_first():
    near, far = points(L, car_back(12.0, -0.5)), points(L, car_back(24.0, 1.2, width_m=2.2))
    boxes = [[382.0, 300.0, 457.0, 366.0], [353.0, 300.0, 397.0, 333.0]]
    found = labeled(joined(near, far), seen(*boxes[::-1]))
    assert set(found.instance[: len(near)].tolist()) <= {-1, 0}
    assert set(found.instance[len(near) :].tolist()) <= {-1, 1}
    assert (found.instance == 0).sum() > 20
    assert (found.instance == 1).sum() > 10


def test_of_boxes_that_a_camera_isnt_sure_of_the_likelier_takes_its_points_before_the_nearer():
    car, larger = points(L, car_back(20.0, 0.0)), [370.0, 296.0, 429.0, 348.0]
    unsure = CameraDetections(np.array([larger, BOX]), np.array([0.3, 0.5]), np.array(["car", "car"]), 0.6)
    found = labeled(car, {"cam": unsure})
    nearer, likelier = (found.observations[at] for at in np.argsort([s.near_m for s in found.observations]))
    assert nearer.xyxy_px.tolist() == larger
    assert not likelier.is_sure
    taken = {tuple(s.xyxy_px.tolist()): len(rows) for s, rows in zip(found.observations, found.taken, strict=True)}
    assert taken[tuple(BOX)] > 25
    assert taken[tuple(larger)] <= 10


def test_radar_may_be_wrong_about_height_and_a_little_about_direction():
    beside = [[20.0, 1.0, 0.0], [20.5, 0.0, 3.0], [21.0, -1.0, -3.0]]
    assert labeled(points(R, beside, rate_mps=3.0), seen(BOX)).instance.tolist() == [0, 0, 0]
    assert labeled(points(L, beside), seen(BOX)).instance.tolist() == [-1, -1, -1]


def test_a_single_point_is_no_object():
    assert labeled(points(L, [[20.0, 0.0, -0.8]]), seen(BOX)).instance.tolist() == [-1]
    assert labeled(points(L, []), seen(BOX)).instance.tolist() == []


def test_without_cameras_nothing_is_labeled():
    found = labeled(points(L, car_back(20.0, 0.0)), {})
    assert (found.instance == -1).all()
    assert not found.height_px.any()


@pytest.mark.parametrize("label", ["other", "train"])
def test_labels_without_a_typical_size_are_left_out(label: str):
    assert labeled(points(L, car_back(20.0, 0.0)), seen(BOX, label=label)).observations == ()
