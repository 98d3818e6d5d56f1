"""Whether truth lies where LiDARs see something."""

import numpy as np
import pytest
from tests.reports.preview.street import UPRIGHT, sample, street_rig

from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.rig import Mount, Rig
from fbench.reports.preview.measure import check_labels

PLACES = np.array([[8.0, 3, 0], [12, -3, 0], [15, 3, 0], [18, -3, 0], [22, 3, 0], [24, -3, 0]])
GROUND = np.array(
    [[r * np.cos(a), r * np.sin(a), -0.95] for r in np.arange(4, 30, 0.5) for a in np.arange(-1, 1, 0.02)]
)


def boxes(places=PLACES, yaw=0.3, **more):
    num = len(places)
    return Boxes3D(np.array(places, float), np.tile([4.0, 1.8, 2.0], (num, 1)), np.full(num, yaw), **more)


def seen(places=PLACES):
    """Ground, and what stands at some places."""
    return np.concatenate([GROUND, *(np.add(p, [[0.3, 0.3, 0.2], [-0.3, 0.2, 0.0]]) for p in places)])


def test_boxes_with_points_are_right():
    found = check_labels([sample(street_rig(), clouds={"lidar": seen()}, boxes=boxes())])
    assert (found.text, found.is_bad) == ("6 of 6 boxes within 25 m hold LiDAR points above the ground", False)


@pytest.mark.parametrize("wrong", [np.subtract(PLACES, [3.4, 0, 0]), PLACES * [1, -1, 1]], ids=["moved", "mirrored"])
def test_labels_in_another_coordinate_frame_are_told(wrong):
    """Points on the ground say nothing."""
    found = check_labels([sample(street_rig(), clouds={"lidar": seen()}, boxes=boxes(wrong, yaw=0.0))])
    assert found.is_bad
    assert "of 6 boxes within 25 m hold LiDAR points" in found.text
    assert found.text.endswith(": wrong coordinate frame, stamps or sizes?")


def test_labels_of_another_world_are_told():
    found = check_labels(
        [sample(street_rig(), clouds={"lidar": seen()}, boxes=boxes(np.add(PLACES, [1200.0, -300, 0])))]
    )
    assert found.is_bad
    assert found.text == "the nearest of 6 boxes is 1244 m away: wrong coordinate frame, or poses of another one?"


def test_nothing_is_said_where_nothing_can_be():
    rig, clouds = street_rig(), {"lidar": seen()}
    assert check_labels([sample(rig, clouds=clouds)]) is None
    assert check_labels([sample(rig, boxes=boxes())]) is None
    assert check_labels([sample(rig, clouds=clouds, boxes=boxes(np.add(PLACES[:2], [3.0, 0, 0])))]) is None  # too few
    assert check_labels([sample(rig, clouds=clouds, boxes=boxes(-PLACES))]) is None  # where no LiDAR looks
    assert check_labels([sample(rig, clouds=clouds, boxes=boxes(np.add(PLACES, [40.0, 0, 0])))]) is None
    assert check_labels([sample(rig, clouds=clouds, boxes=boxes(ignore=np.ones(6, bool)))]) is None


def test_points_are_taken_in_body_coordinates():
    rig = Rig({"lidar": Mount("lidar", np.array([2.0, 0, 1]), UPRIGHT)}, {})
    assert not check_labels([sample(rig, clouds={"lidar": seen() - [2.0, 0, 1]}, boxes=boxes())]).is_bad
