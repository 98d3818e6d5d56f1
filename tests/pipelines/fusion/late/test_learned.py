"""Late fusion of what a network sees in LiDAR's points, and in the radars' echoes."""

from dataclasses import replace

import numpy as np
import pytest
from tests.pipelines.fusion.views import car, lidar_view, outline, radar_view, seen, standing_view

from fbench.pipelines.fusion.late.existence import FusionParams
from fbench.pipelines.fusion.late.fuse import fuse

PARAMS = FusionParams(lidar_weight=1.0)


def test_what_a_network_sees_by_echoes_alone_is_no_work_of_lidar():
    box = car(15.0, 1.0)
    view = lidar_view(box)
    view = replace(view, learned=True, boxes=replace(view.boxes, sources=np.array([4], np.uint8)))
    assert fuse(seen(outline(box), view), PARAMS).sources.tolist() == [5]


def network_view(with_echoes):
    """What a network sees that gets a high wall 48 m ahead and a car beside the road."""
    view, y = lidar_view(car(12.0, -6.0)), np.linspace(-45.0, 45.0, 181)
    wall = np.column_stack([np.full(len(y), 48.0), y, np.full(len(y), 2.0)])
    xyz, cluster = np.concatenate([wall, view.xyz]), np.append(np.full(len(y), -1), view.cluster)
    return replace(view, xyz=xyz, cluster=cluster, learned=True, with_echoes=with_echoes)


def believe(box, radar, with_echoes, score=0.6, **params):
    """How probable a car is of which cameras and `radar` tell, and the network doesn't."""
    cameras = None if score is None else outline(box, score=score)
    found = fuse(seen(cameras, network_view(with_echoes), radar), replace(PARAMS, min_score=0.0, **params))
    scores = found.score[np.hypot(*(found.center_m[:, :2] - box.center_m[0, :2]).T) < 3.0]
    return float(scores.max(initial=0.0))


@pytest.mark.parametrize("view", [radar_view, standing_view])
def test_echoes_that_a_network_ignored_do_not_speak_for_what_a_camera_sees(view):
    ghost, elsewhere = car(25.0, 4.0), car(25.0, -14.0)
    assert believe(ghost, view(ghost), with_echoes=False) > believe(ghost, view(elsewhere), with_echoes=False)
    assert believe(ghost, view(ghost), with_echoes=True) <= believe(ghost, view(elsewhere), with_echoes=True)
    assert believe(ghost, view(ghost), with_echoes=True, score=None) == 0.0


def test_a_weak_camera_box_is_not_confirmed_by_echoes_that_a_network_ignored():
    ghost = car(25.0, 4.0)
    weak = replace(outline(ghost, score=0.45), min_score=0.5)
    for with_echoes, num in ((False, 2), (True, 1)):
        views = seen(weak, network_view(with_echoes), radar_view(ghost))
        assert len(fuse(views, replace(PARAMS, min_score=0.0))) == num


def test_a_network_says_nothing_of_echoes_beyond_its_image():
    for far in (car(57.0), car(40.0, -57.0)):
        radar = radar_view(far)
        assert believe(far, radar, True, None) == pytest.approx(believe(far, radar, False, None), abs=0.02)
    far = car(57.0)
    assert believe(far, radar_view(far), True, None) > 0.5
    assert believe(far, radar_view(far), True) >= believe(far, radar_view(far), False) > 0.8


def test_a_network_that_gets_echoes_is_expected_to_see_farther_unless_told():
    ghost, radar = car(35.0, 4.0), radar_view(car(35.0, -14.0))
    heard = believe(ghost, radar, with_echoes=True)
    assert heard < believe(ghost, radar, with_echoes=False)
    assert believe(ghost, radar, with_echoes=True, lidar_half_m=50.0) == heard
    assert believe(ghost, radar, with_echoes=True, lidar_half_m=100.0) < heard


@pytest.mark.parametrize("label", ["car", "van"])
def test_a_box_of_echoes_is_where_the_network_puts_it(label):
    """Echoes measure heights badly, so that what stands for them lies in the box."""
    box = car(30.0, 2.0, yaw=0.1)
    inner = np.array([[x, y, z] for x in (-1.2, 1.2) for y in (-0.5, 0.5) for z in (-0.4, 0.4)]) + box.center_m
    view = lidar_view(box, score=0.7)
    boxes = replace(view.boxes, label=np.array(["car"]), sources=np.array([4], np.uint8))
    view = replace(view, xyz=inner, cluster=np.zeros(8, np.int64), boxes=boxes, learned=True, with_echoes=True)
    found = fuse(seen(outline(box, label=label, score=0.8), view, standing_view(box)), PARAMS)
    assert found.sources.tolist() == [5]
    assert found.score[0] > 0.9, "both agree"
    assert found.center_m[0, :2] == pytest.approx([30.0, 2.0], abs=0.5)
    assert found.size_lwh_m[0] == pytest.approx(box.size_lwh_m[0])


def test_a_hidden_car_that_a_network_sees_is_not_doubted_for_a_weak_box_in_that_of_the_car_in_front():
    front, hidden = car(12.0), car(19.0, 0.3)
    lidar = replace(lidar_view(front, hidden, score=0.8), learned=True)
    alone, both = (fuse(seen(outline(*cars), lidar), PARAMS) for cars in ((front,), (front, hidden)))
    for found in (alone, both):
        assert found.score[np.argmax(found.center_m[:, 0])] == pytest.approx(0.8, abs=0.02)
    by_clusters = fuse(seen(outline(front, hidden), replace(lidar, learned=False)), replace(PARAMS, min_score=0.0))
    assert by_clusters.score[np.argmax(by_clusters.center_m[:, 0])] < 0.4
