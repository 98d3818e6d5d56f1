"""Cameras with lens distortion lift boxes as pinhole cameras at the same place do."""

from dataclasses import replace

import numpy as np
import pytest
from tests.pipelines.fusion.views import PLANE, RIG, car, lidar_view, outline, radar_view

from fbench.pipelines.fusion.late.existence import FusionParams
from fbench.pipelines.fusion.late.fuse import SensorViews, fuse
from fbench.pipelines.fusion.observations import AssociationParams, observe_camera, undistort_box
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.geometry.camera import project_boxes

BENT = [("plumb_bob", (-0.25, 0.08, 0.001, -0.001, 0.0)), ("rational", (0.3, 0.1, 0, 0, 0, 0.5, 0.1, 0)),
        ("fisheye", (0.02, -0.01, 0.0, 0.0))]  # fmt: skip


def bent_rig(model, coefficients, f_px=1000.0):
    intrinsics = np.array([[f_px, 0, 640], [0, f_px, 360], [0, 0, 1]])
    return Rig(RIG.mounts, {"cam": CameraModel(intrinsics, (1280, 720), model, np.array(coefficients, np.float64))})


def near_side(rig, box):
    size = box.size_lwh_m[0]
    ahead = np.array([np.cos(box.yaw_rad[0]), np.sin(box.yaw_rad[0]), 0])
    near = Boxes3D(box.center_m - ahead * size[0] / 2, np.array([[0.01, size[1], size[2]]]), box.yaw_rad)
    rectangles, seen = project_boxes(rig, "cam", near)
    assert seen.all()
    return CameraDetections(rectangles, np.array([0.8]), np.array(["car"]))


@pytest.mark.parametrize(("model", "coefficients"), BENT)
@pytest.mark.parametrize(("x_m", "y_m"), [(15.0, 0.0), (20.0, 6.0), (25.0, -9.0)])
def test_a_bent_image_tells_what_a_straight_one_does(model, coefficients, x_m, y_m):
    rig, box = bent_rig(model, coefficients), car(x_m, y_m)
    (bent,) = observe_camera(rig, "cam", near_side(rig, box), PLANE, AssociationParams())
    (straight,) = observe_camera(RIG, "cam", near_side(RIG, box), PLANE, AssociationParams())
    assert bent.near_m == pytest.approx(straight.near_m, rel=0.03)
    assert bent.bearing_rad == pytest.approx(straight.bearing_rad, abs=0.005)
    assert bent.size_lwh_m == pytest.approx(straight.size_lwh_m, rel=0.05)
    assert bent.cut == straight.cut


def test_a_pinhole_box_stays_as_it_is():
    box = np.array([10.0, 20.0, 300.0, 200.0])
    view = undistort_box(RIG, "cam", box)
    assert view is not None
    assert view[0] is box
    assert view[1].tolist() == RIG.body_T_sensor("cam").tolist()


@pytest.mark.parametrize("bearing", [0.0, 80.0, -95.0, 110.0])
def test_a_fisheye_lifts_what_is_beside_and_behind_it(bearing):
    rig, angle = bent_rig("fisheye", (0.0, 0.0, 0.0, 0.0), f_px=300.0), np.radians(bearing)
    box = car(0.0)
    place = 12 * np.array([np.cos(angle), np.sin(angle), 0]) + [0.5, 0, box.center_m[0, 2]]
    box = replace(box, center_m=place[None], yaw_rad=np.array([angle]))
    (observation,) = observe_camera(rig, "cam", near_side(rig, box), PLANE, AssociationParams())
    # Far from the axis a car looks taller on its outer side, and so do boxes around it.
    assert observation.near_m == pytest.approx(12 - 2.1, rel=0.07)
    assert observation.bearing_rad == pytest.approx(angle, abs=0.01)


def test_the_border_of_the_real_image_cuts():
    rig = bent_rig("plumb_bob", (-0.25, 0.08, 0, 0, 0))
    found = CameraDetections(np.array([[1000.0, 300, 1279, 460]]), np.array([0.8]), np.array(["car"]))
    (observation,) = observe_camera(rig, "cam", found, PLANE, AssociationParams())
    assert observation.cut
    assert observation.xyxy_px.tolist() == [1000, 300, 1279, 460]


def test_a_box_that_no_ray_leads_to_is_left_out():
    rig = bent_rig("plumb_bob", (-0.9, 0, 0, 0, 0))  # reaches 0.41: 406 px
    found = CameraDetections(np.array([[0.0, 0, 100, 100], [600, 340, 680, 400]]), np.ones(2), np.array(["car", "car"]))
    assert [s.xyxy_px[0] for s in observe_camera(rig, "cam", found, PLANE, AssociationParams())] == [600]


@pytest.mark.parametrize(("model", "coefficients"), BENT)
def test_fusion_with_a_bent_camera(model, coefficients):
    rig, box = bent_rig(model, coefficients), car(20.0, 4.0)
    seen = SensorViews(rig, {"cam": near_side(rig, box)}, lidar_view(box), radar_view(box))
    straight = SensorViews(RIG, {"cam": outline(box)}, lidar_view(box), radar_view(box))
    (center,), (expected,) = fuse(seen, FusionParams()).center_m, fuse(straight, FusionParams()).center_m
    assert center == pytest.approx(expected, abs=0.05)
    assert fuse(seen, FusionParams()).sources.tolist() == [7]
