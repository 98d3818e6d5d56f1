"""What several cameras see of one object is one piece of evidence."""

import numpy as np
import pytest
from tests.pipelines.fusion.early.clouds import L, joined, points
from tests.pipelines.fusion.views import AHEAD, PLANE, K, car
from tests.pipelines.scenes import car_back

from fbench.pipelines.fusion.early.groups import SemanticsParams, label_points
from fbench.pipelines.fusion.joint import UNREPORTED, camera_ratios, join_observations
from fbench.pipelines.fusion.observations import AssociationParams, observe_camera
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.geometry.camera import project_boxes

AWAY = np.array([0.5, 0.5, -0.5, -0.5])  # Looks back
NAMES = ("left", "middle", "right")
RIG = Rig(
    {
        **{name: Mount("camera", np.array([0.5, y, 0]), AHEAD) for name, y in zip(NAMES, (0.2, 0, -0.2), strict=True)},
        "back": Mount("camera", np.array([-0.5, 0, 0]), AWAY),
    },
    dict.fromkeys((*NAMES, "back"), CameraModel(K, (1280, 720))),
)


def observed(**scores):
    """What cameras see of a car 20 m ahead, with the scores of their boxes."""
    box, result = project_boxes, []
    for name, scored in sorted(scores.items()):
        found = np.repeat(box(RIG, name, car(20.0))[0], len(scored), axis=0)
        boxes = CameraDetections(found, np.array(scored, np.float64), np.full(len(scored), "car"))
        result += observe_camera(RIG, name, boxes, PLANE, AssociationParams())
    return result


def logit(p):
    return np.log(p / (1 - p))


def joint(working=NAMES, **scores):
    return join_observations(RIG, sorted(working), observed(**scores), AssociationParams())


def test_the_mean_of_what_cameras_say_counts():
    found = joint(left=[0.6], middle=[0.7], right=[0.9])
    assert found.number.tolist() == [0, 0, 0]
    mean = (logit(0.6) + logit(0.7) + logit(0.9)) / 3
    assert logit(found.score) == pytest.approx([mean] * 3)
    assert found.is_sure.all()


def test_the_same_opinion_of_more_cameras_says_no_more():
    assert joint(left=[0.7], middle=[0.7], right=[0.7]).score == pytest.approx([0.7] * 3)
    assert joint(working=["middle"], middle=[0.7]).score.tolist() == [0.7]


def test_a_camera_that_ought_to_see_it_and_does_not_speaks_against_it():
    found = joint(middle=[0.7])
    assert logit(found.score) == pytest.approx([(logit(0.7) + 2 * logit(UNREPORTED)) / 3], abs=1e-3)
    assert not found.is_sure.any()


def test_one_that_looks_elsewhere_says_nothing():
    assert joint(working=["middle", "back"], middle=[0.7]).score == pytest.approx([0.7])


def test_two_boxes_of_one_camera_are_not_one_observation_and_the_surer_one_is_joined():
    found = joint(left=[0.8], middle=[0.3, 0.8], working=["left", "middle"])
    assert found.number.tolist() == [0, 1, 0]


def test_a_bicycle_may_be_a_motorcycle_and_no_car():
    seen = observed(left=[0.8], middle=[0.8])
    kinds = [("bicycle", "motorcycle"), ("car", "truck"), ("car", "bicycle"), ("pedestrian", "car")]
    ratios = []
    for labels in kinds:
        named = [type(one)(**{**vars(one), "label": label}) for one, label in zip(seen, labels, strict=True)]
        ratios.append(camera_ratios(named, AssociationParams())[0, 1])
    assert np.isfinite(ratios).tolist() == [True, True, False, False]


def test_one_false_alarm_of_three_cameras_takes_points_once():
    """Cars one behind the other, of which each camera guesses another one: one group of points is seen."""
    cloud = joined(points(L, car_back(18.0, 0.0)), points(L, car_back(23.0, 0.0)))
    cameras = {}
    for name, distance in zip(NAMES, (20.1, 25.1, 20.1), strict=True):
        box = project_boxes(RIG, name, car(distance))[0]
        cameras[name] = CameraDetections(box, np.array([0.6]), np.array(["car"]))
    seen = label_points(RIG, cameras, cloud, PLANE, SemanticsParams())
    assert seen.joint.number.tolist() == [0, 0, 0]
    assert len(np.unique(seen.instance[seen.instance >= 0])) == 1
