"""Late fusion of what a network sees in LiDAR's points, and in the radars' echoes."""

from dataclasses import replace

import numpy as np
import pytest
from tests.pipelines.fusion.views import PLANE, car, lidar_view, outline, radar_view, seen, standing_view

from fbench.pipelines.fusion.late.existence import FusionParams
from fbench.pipelines.fusion.late.fuse import fuse, observe
from fbench.pipelines.fusion.sizes import SIZES
from fbench.pipelines.sensors.lidar.clusters import LidarView
from fbench.replay.data.boxes import concatenate

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
    ghost, elsewhere = car(25.0, 4.0), car(28.0, 1.0)  # in one sector, so that radar's silence counts
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


def of_echoes(box, label="car", score=0.7):
    """What a network sees by echoes alone: points in its box that stand for it."""
    inner = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 1)]) * 0.3 * box.size_lwh_m
    boxes = replace(lidar_view(box, score=score).boxes, label=np.array([label]), sources=np.array([4], np.uint8))
    cluster = np.zeros(len(inner), np.int64)
    return LidarView(PLANE, box.center_m + inner, cluster, boxes, learned=True, with_echoes=True)


@pytest.mark.parametrize("label", ["car", "van"])
def test_a_box_of_echoes_is_where_the_network_puts_it(label):
    """Echoes measure heights badly, so that what stands for them lies in the box."""
    box = car(30.0, 2.0, yaw=0.1)
    found = fuse(seen(outline(box, label=label, score=0.8), of_echoes(box), standing_view(box)), PARAMS)
    assert found.sources.tolist() == [5]
    assert found.score[0] > 0.9, "both agree"
    assert found.center_m[0, :2] == pytest.approx([30.0, 2.0], abs=0.5)
    size = SIZES[label]
    expected = box.size_lwh_m[0] if label == "car" else (size.length_m, size.width_m, size.height_m)
    assert found.size_lwh_m[0] == pytest.approx(expected)


@pytest.mark.parametrize(("score", "expected"), [(0.95, "bus"), (0.45, "van")])
def test_the_size_of_a_box_of_echoes_does_not_name_the_class_against_a_surer_camera(score, expected):
    bus = car(40.0, 2.0, size=(12.0, 2.6, 3.6))
    found = fuse(seen(outline(bus, label="van", score=0.9), of_echoes(bus, "bus", score)), PARAMS)
    assert found.label.tolist() == [expected]


def test_what_stands_for_a_box_of_echoes_hides_nothing_and_measures_no_distance():
    near, hidden = car(15.0), car(25.0, 0.5)
    lidar = network_view(True)
    alone = fuse(seen(outline(hidden, score=0.6), lidar), replace(PARAMS, min_score=0.0))
    echoes = of_echoes(near, score=0.1)
    both = replace(
        lidar,
        xyz=np.concatenate([lidar.xyz, echoes.xyz]),
        cluster=np.concatenate([lidar.cluster, echoes.cluster + 1]),
        boxes=concatenate([replace(lidar.boxes, sources=np.array([2], np.uint8)), replace(echoes.boxes, label=None)]),
    )
    found = fuse(seen(outline(hidden, score=0.6), both), replace(PARAMS, min_score=0.0))
    at, alone_at = (np.argmax(boxes.center_m[:, 0]) for boxes in (found, alone))
    assert found.center_m[at] == pytest.approx(alone.center_m[alone_at])
    assert found.score[at] == pytest.approx(alone.score[alone_at])


def test_what_stands_for_a_box_of_echoes_is_no_point_of_lidar():
    box = car(20.0)
    by_echoes, by_lidar = of_echoes(box), replace(of_echoes(box), boxes=lidar_view(box).boxes)
    for view, expected in ((by_lidar, 18.7), (by_echoes, np.nan)):
        (distance,) = observe(seen(outline(box), view), PARAMS).obstacle_m
        assert distance == pytest.approx(expected, abs=0.6, nan_ok=True)


def test_a_network_that_gets_no_points_but_echoes_has_looked_there():
    ghost = car(25.0, 4.0)
    nothing = LidarView(PLANE, np.zeros((0, 3)), np.zeros(0, np.int64), lidar_view().boxes, learned=True)

    def believed(with_echoes):
        view = replace(nothing, with_echoes=with_echoes)
        return float(
            fuse(seen(outline(ghost, score=0.6), view, radar_view(ghost)), replace(PARAMS, min_score=0.0)).score[0]
        )

    assert believed(with_echoes=True) < 0.3
    assert believed(with_echoes=False) > 0.8


def test_a_hidden_car_that_a_network_sees_is_not_doubted_for_a_weak_box_in_that_of_the_car_in_front():
    front, hidden = car(12.0), car(19.0, 0.3)
    lidar = replace(lidar_view(front, hidden, score=0.8), learned=True)
    alone, both = (fuse(seen(outline(*cars), lidar), PARAMS) for cars in ((front,), (front, hidden)))
    for found in (alone, both):
        assert found.score[np.argmax(found.center_m[:, 0])] == pytest.approx(0.8, abs=0.02)
    by_clusters = fuse(seen(outline(front, hidden), replace(lidar, learned=False)), replace(PARAMS, min_score=0.0))
    assert by_clusters.score[np.argmax(by_clusters.center_m[:, 0])] < 0.4
