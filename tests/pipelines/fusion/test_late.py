from dataclasses import replace

import numpy as np
import pytest

from fbench.pipelines.fusion.late import fuse
from fbench.pipelines.fusion.params import FusionParams

from .views import car, lidar_view, outline, radar_view, seen, standing_view

PARAMS = FusionParams(lidar_weight=0.5)


def test_three_sensors_make_one_object():
    box = car(20.0, 2.0)
    found = fuse(seen(outline(box), lidar_view(box), radar_view(box)), PARAMS)
    assert len(found) == 1
    assert found.center_m == pytest.approx(box.center_m, abs=0.05)
    assert found.label.tolist() == ["car"]
    assert found.sources.tolist() == [7]
    assert found.velocity_mps.tolist() == [[3, 0, 0]]
    strengths = 0.6 * 0.8, 0.5 * (1 - np.exp(-3)), 0.93 * (1 - np.exp(-2))
    assert found.score[0] == pytest.approx(1 - np.prod([1 - s for s in strengths]), abs=0.02)


def test_camera_and_radar_without_lidar():
    box = car(30.0, -3.0)
    found = fuse(seen(outline(box), None, radar_view(box)), PARAMS)
    assert found.sources.tolist() == [5]
    assert found.center_m[0, :2] == pytest.approx(box.center_m[0, :2], abs=0.3)


def test_points_correct_what_the_image_guesses():
    small = car(20.0, size=(4.0, 1.7, 1.35))
    guess = fuse(seen(outline(small)), PARAMS)
    found = fuse(seen(outline(small), lidar_view(small, score=0.0)), PARAMS)
    assert found.sources.tolist() == [3]
    assert abs(found.center_m[0, 0] - 20) < abs(guess.center_m[0, 0] - 20)
    assert found.center_m[0, 0] == pytest.approx(20, abs=0.2)


def test_standing_echoes_confirm_but_give_no_velocity():
    box = car(20.0)
    found = fuse(seen(outline(box), None, standing_view(box)), PARAMS)
    assert found.sources.tolist() == [5]
    assert np.isnan(found.velocity_mps).all()


def test_a_camera_box_that_nothing_confirms_is_dropped_unless_no_other_sensor_works():
    box, other = car(20.0), car(20.0, -6.0)
    assert len(fuse(seen(outline(box), lidar_view(other)), replace(PARAMS, unseen_factor=0.0))) == 0
    found = fuse(seen(outline(box)), PARAMS)
    assert found.sources.tolist() == [1]
    assert found.score.tolist() == [0.8]
    assert found.center_m == pytest.approx(box.center_m, abs=0.2)


def test_what_a_camera_ought_to_see_and_does_not_loses():
    ahead, behind = car(20.0), car(-20.0)
    found = fuse(seen(outline(), None, radar_view(ahead, behind)), PARAMS)
    assert found.center_m[:, 0].tolist() == [-20.0]
    assert found.score == pytest.approx(0.93 * 0.9)
    assert found.sources.tolist() == [4]
    without_camera = fuse(seen(None, None, radar_view(ahead, behind)), PARAMS)
    assert without_camera.center_m[:, 0].tolist() == [-20.0, 20.0]


def test_lidar_and_radar_without_camera():
    box = car(20.0, 2.0)
    off = car(21.0, 2.5)
    found = fuse(seen(None, lidar_view(box), radar_view(off, score=0.8)), PARAMS)
    assert len(found) == 1
    assert found.sources.tolist() == [6]
    assert found.center_m == pytest.approx(box.center_m)
    assert found.velocity_mps.tolist() == [[3, 0, 0]]
    assert found.score[0] == pytest.approx(1 - (1 - 0.45) * (1 - 0.93 * 0.8))
    assert found.label.tolist() == ["car"]


def test_long_objects_without_camera_are_trucks():
    found = fuse(seen(None, None, radar_view(car(20.0, size=(12.0, 2.5, 3.0)))), PARAMS)
    assert found.label.tolist() == ["truck"]


def test_the_nearer_of_two_cars_in_one_direction_takes_its_points_first():
    near, far = car(15.0, 0.0), car(28.0, 0.6)
    found = fuse(seen(outline(near, far), lidar_view(near, far), radar_view(near, far)), PARAMS)
    assert sorted(found.center_m[:, 0]) == pytest.approx([15.0, 28.0], abs=0.5)
    assert found.sources.tolist() == [7, 7]


def test_points_at_another_distance_do_not_belong():
    box = car(12.0)
    found = fuse(seen(outline(box), lidar_view(car(30.0), score=0.0)), replace(PARAMS, min_score=0.4))
    assert found.sources.tolist() == [1]
    assert found.center_m[0, 0] == pytest.approx(12.0, abs=0.5)


def test_duplicates_are_merged():
    box = car(20.0)
    found = fuse(seen(outline(box), lidar_view(box, car(21.0)), radar_view(box, car(22.0))), PARAMS)
    assert len(found) == 1


@pytest.mark.parametrize("camera", [None, outline()])
def test_nothing_seen_has_the_same_fields(camera):
    box = car(20.0)
    full = fuse(seen(outline(box), lidar_view(box)), PARAMS)
    empty = fuse(seen(camera), PARAMS)
    assert len(empty) == 0
    assert empty.arrays().keys() == full.arrays().keys()


def test_order_of_camera_boxes_changes_nothing():
    cars = car(15.0, -2.0), car(20.0, 2.0), car(33.0, 0.0)
    camera = outline(*cars)
    turned = type(camera)(camera.xyxy_px[::-1], camera.score[::-1], camera.label[::-1])
    for name, value in fuse(seen(camera, lidar_view(*cars)), PARAMS).arrays().items():
        other = fuse(seen(turned, lidar_view(*cars)), PARAMS).arrays()[name]
        np.testing.assert_array_equal(value, other)
