import numpy as np
import pytest
from tests.pipelines.fusion.views import PLANE, RIG, car, outline

from fbench.pipelines.fusion.observations import AT_MIN_SCORE, AssociationParams, as_probability, observe_camera
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.replay.geometry.camera import project_boxes

PARAMS = AssociationParams()


def lift(found, plane=PLANE):
    return observe_camera(RIG, "cam", found, plane, PARAMS)


@pytest.mark.parametrize("distance", [8.0, 20.0, 45.0])
@pytest.mark.parametrize("plane", [PLANE, None])
def test_distance_of_a_typical_car(distance, plane):
    (observation,) = lift(outline(car(distance, 1.0)), plane)
    near = np.hypot(distance - 2.1 - 0.5, 1.0)
    assert observation.near_m == pytest.approx(near, rel=0.01)
    assert observation.bearing_rad == pytest.approx(np.arctan2(1.0, distance - 2.6), abs=0.01)
    assert observation.depth_m == pytest.approx(2.1, abs=0.02)
    assert observation.aspect_rad == pytest.approx(0.0, abs=0.02)
    assert not observation.cut


def test_the_ground_tells_the_distance_of_a_car_of_unusual_height():
    box = car(15.0, size=(4.2, 1.8, 2.0))
    with_ground, without = lift(outline(box))[0], lift(outline(box), None)[0]
    assert abs(with_ground.near_m - 12.4) < 1.0
    assert abs(without.near_m - 12.4) > 2
    assert with_ground.std < without.std


def test_a_low_truck_is_a_van():
    (observation,) = lift(outline(car(15.0, size=(5.0, 2.0, 2.0)), label="truck"))
    assert observation.size_lwh_m == pytest.approx([5.0, 2.0, 2.0], rel=0.1)
    (observation,) = lift(outline(car(20.0, size=(8.0, 2.5, 3.2)), label="truck"))
    assert observation.size_lwh_m == pytest.approx([8.0, 2.5, 3.2], rel=0.1)


def test_a_car_seen_from_its_side():
    box = car(15.0, size=(4.2, 1.8, 1.55), yaw=np.pi / 2)
    rectangle, _ = project_boxes(RIG, "cam", box)
    found = CameraDetections(rectangle, np.array([0.8]), np.array(["car"]))
    (observation,) = lift(found)
    assert observation.aspect_rad == pytest.approx(np.pi / 2)
    assert observation.depth_m == pytest.approx(0.9)


def test_a_bus_that_the_border_cuts_off_reaches_beyond_it():
    found = CameraDetections(np.array([[900.0, 250, 1279, 460]]), np.array([0.8]), np.array(["bus"]))
    (observation,) = lift(found)
    assert observation.cut
    assert observation.beside_m < -2
    assert observation.aspect_rad == pytest.approx(np.pi / 2)


def test_a_car_whose_foot_is_below_the_image_is_guessed_by_height_with_care():
    found = CameraDetections(np.array([[500.0, 300, 800, 719]]), np.array([0.8]), np.array(["car"]))
    (observation,) = lift(found)
    assert observation.std == pytest.approx(0.3)


def test_boxes_above_the_horizon_and_other_labels():
    high = CameraDetections(np.array([[600.0, 100, 640, 140]]), np.array([0.8]), np.array(["car"]))
    assert np.isfinite(lift(high)[0].near_m)
    other = CameraDetections(np.array([[600.0, 400, 640, 440]]), np.array([0.8]), np.array(["other"]))
    assert lift(other) == []
    assert lift(outline()) == []


def test_scores_of_detectors_are_compared_by_what_they_recommend_to_report():
    assert as_probability(0.4, 0.4) == pytest.approx(as_probability(0.6, 0.6)) == pytest.approx(AT_MIN_SCORE)
    assert as_probability(0.3, 0.6) < as_probability(0.5, 0.6) < AT_MIN_SCORE < as_probability(0.7, 0.6)
    assert as_probability(0.7, 0.0) == 0.7  # none recommended
    assert (as_probability(0.0, 0.5), as_probability(1.0, 0.5)) == (0.0, 1.0)
