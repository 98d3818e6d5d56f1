from dataclasses import replace

import numpy as np
import pytest
from tests.pipelines.fusion.views import car, lidar_view, outline, radar_view, seen, standing_view

from fbench.pipelines.fusion.late.existence import FusionParams, resolve_weight
from fbench.pipelines.fusion.late.fuse import fuse
from fbench.replay.data.boxes import Boxes3D

PARAMS = FusionParams(lidar_weight=1.0)


def odds(probability):
    return float(np.log(probability / (1 - probability)))


def probability(value):
    return 1 / (1 + np.exp(-value))


def test_three_sensors_make_one_object():
    box = car(20.0, 2.0)
    found = fuse(seen(outline(box), lidar_view(box), radar_view(box)), replace(PARAMS, overlap=0.0))
    assert len(found) == 1
    assert found.center_m == pytest.approx(box.center_m, abs=0.1)
    assert found.label.tolist() == ["car"]
    assert found.sources.tolist() == [7]
    assert found.velocity_mps.tolist() == [[3, 0, 0]]
    confirmed = max(0.8 * 0.9, PARAMS.confirmed_radar * (1 - np.exp(-40 / 8)))
    added = odds(0.8), odds(0.9), odds(confirmed)
    assert found.score[0] == pytest.approx(probability(sum(added) - 2 * odds(PARAMS.prior)))


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


def test_a_box_that_guesses_another_distance_does_not_move_what_lidar_and_radar_see():
    """A camera by night takes the light about a car for a nearer, larger one."""
    box = car(28.0)
    ((left, top, right, bottom),) = outline(box).xyxy_px
    large = replace(outline(box), xyxy_px=np.array([[left - 40, top - 64, right + 40, bottom + 160]]))
    assert fuse(seen(large), PARAMS).center_m[0, 0] < 12.0
    found = fuse(seen(large, lidar_view(box), radar_view(box)), PARAMS)
    assert found.sources.tolist() == [7]
    assert found.center_m[0, 0] == pytest.approx(28.0, abs=0.5)


def test_standing_echoes_confirm_but_give_no_velocity():
    box = car(20.0)
    found = fuse(seen(outline(box), None, standing_view(box)), PARAMS)
    assert found.sources.tolist() == [5]
    assert np.isnan(found.velocity_mps).all()


def test_a_camera_box_that_lidar_ought_to_confirm_loses_unless_no_other_sensor_works():
    box, other = car(12.0), car(13.0, -3.5)
    alone = fuse(seen(outline(box)), PARAMS)
    assert alone.sources.tolist() == [1]
    assert alone.score == pytest.approx([0.8])
    assert alone.center_m == pytest.approx(box.center_m, abs=0.2)
    found = fuse(seen(outline(box), lidar_view(other)), replace(PARAMS, min_score=0.0))
    assert found.score[found.sources == 1][0] < 0.5


def test_a_sensor_that_something_hides_from_an_object_says_nothing():
    front, behind, beside = car(10.0), car(28.0, 0.5), car(28.0, -6.0)
    found = fuse(seen(outline(front, behind, beside), lidar_view(front)), replace(PARAMS, min_score=0.0, unlikely=1.0))
    hidden, visible = (found.score[np.argmin(np.abs(found.center_m[:, 1] - y))] for y in (0.5, -6.0))
    assert hidden > visible + 0.05


def test_what_a_camera_ought_to_see_and_does_not_loses():
    ahead, behind = car(20.0), car(-20.0)
    found = fuse(seen(outline(), None, radar_view(ahead, behind)), PARAMS)
    score = dict(zip(found.center_m[:, 0], found.score, strict=True))
    assert score[-20.0] == pytest.approx(0.8 * 0.9)
    assert score.get(20.0, 0.0) < 0.6
    assert found.sources.tolist() == [4] * len(found)
    without_camera = fuse(seen(None, None, radar_view(ahead, behind)), PARAMS)
    assert without_camera.score == pytest.approx([0.8 * 0.9] * 2)


def test_lidar_and_radar_without_camera():
    box = car(20.0, 2.0)
    off = car(21.0, 2.5)
    found = fuse(seen(None, lidar_view(box), radar_view(off)), PARAMS)
    assert len(found) == 1
    assert found.sources.tolist() == [6]
    assert 20.0 < found.center_m[0, 0] < 20.6  # LiDAR is the better one
    assert found.center_m[0, 1] == pytest.approx(2.0, abs=0.1)
    assert found.velocity_mps.tolist() == [[3, 0, 0]]
    assert found.score[0] == pytest.approx(probability(odds(0.9) + odds(0.8 * 0.9) - odds(PARAMS.prior)))
    assert found.label.tolist() == ["car"]


def test_scores_are_believed_less_where_rules_have_a_say():
    view = lidar_view(car(20.0, 2.0))
    for judge, with_cameras, alone in (("model", 1.0, 1.0), ("both", 0.5, 0.65), ("rules", 0.5, 0.65)):
        assert resolve_weight(FusionParams(), judge, has_camera=False).lidar_weight == alone
        params, weight = resolve_weight(FusionParams(), judge, has_camera=True), with_cameras
        assert fuse(seen(None, view), params).score == pytest.approx([weight * 0.9])
        assert resolve_weight(FusionParams(lidar_weight=0.7), judge, has_camera=True).lidar_weight == 0.7


def test_points_of_any_cluster_place_what_only_a_camera_detects():
    small = car(20.0, size=(4.0, 1.7, 1.35))  # lower than a camera takes cars for: it guesses 23 m
    wall = lidar_view(car(20.0, 0.0, size=(4.0, 1.7, 1.35)), score=0.0)
    other = replace(wall, cluster=np.full(len(wall.xyz), -1), boxes=Boxes3D.empty())
    guess, found, loose = (fuse(seen(outline(small), view), PARAMS).center_m[0, 0] for view in (None, wall, other))
    assert abs(found - 20) < abs(guess - 20)
    assert abs(loose - 20) < 0.7 * abs(guess - 20)


def test_long_objects_without_camera_are_trucks():
    found = fuse(seen(None, None, radar_view(car(20.0, size=(12.0, 2.5, 3.0)))), PARAMS)
    assert found.label.tolist() == ["truck"]


def test_the_nearer_of_two_cars_in_one_direction_takes_its_points_first():
    near, far = car(15.0, 0.0), car(28.0, 1.6)
    found = fuse(seen(outline(near, far), lidar_view(near, far), radar_view(near, far)), PARAMS)
    assert sorted(found.center_m[:, 0]) == pytest.approx([15.0, 28.0], abs=0.5)
    assert found.sources.tolist() == [7, 7]


def test_points_at_another_distance_do_not_belong():
    box = car(12.0)
    found = fuse(seen(outline(box), lidar_view(car(30.0), score=0.0)), replace(PARAMS, min_score=0.1))
    assert found.sources[0] == 1
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


@pytest.mark.parametrize(("yaw", "velocity"), [(0.0, (4.0, 0.0)), (np.pi / 4, (4.0, 4.0)), (np.pi / 2, (4.0, 0.0))])
def test_a_radial_speed_is_taken_along_the_heading_that_lidar_shows(yaw, velocity):
    box = car(20.0, yaw=yaw)
    points = box.center_m[0] + np.linspace(-2, 2, 30)[:, None] * np.array([np.cos(yaw), np.sin(yaw), 0.0])
    lidar = replace(lidar_view(box), xyz=points)
    found = fuse(seen(None, lidar, radar_view(box, velocity=(4.0, 0.0, 0.0))), PARAMS)
    assert found.velocity_mps[0, :2] == pytest.approx(velocity, abs=0.01)


def test_a_pedestrian_stands_where_its_points_are():
    person = car(15.0, 1.0, size=(0.6, 0.6, 1.7))
    whole = car(17.0, 1.0)  # a car that begins at the person's back, as a detector without classes completes it
    points = np.column_stack([np.full(12, 14.8), 1 + np.linspace(-0.25, 0.25, 12), np.linspace(-1.3, 0.1, 12)])
    lidar = replace(lidar_view(whole), xyz=points, cluster=np.zeros(12, np.int64))
    found = fuse(seen(outline(person, label="pedestrian"), lidar), PARAMS)
    assert found.label.tolist() == ["pedestrian"]
    assert found.center_m[0, :2] == pytest.approx([15.1, 1.0], abs=0.25)
    assert found.size_lwh_m[0].tolist() == [0.6, 0.6, 1.7]


def test_the_label_of_a_lidar_that_knows_classes_is_taken_where_no_camera_sees():
    box = car(-20.0)
    view = lidar_view(box)
    van = replace(view, boxes=replace(view.boxes, label=np.array(["van"])))
    assert fuse(seen(outline(), van), PARAMS).label.tolist() == ["van"]


def named(view, *labels):
    """What a LiDAR that knows classes gives."""
    return replace(view, boxes=replace(view.boxes, label=np.array(labels)))


def test_points_higher_than_what_the_camera_names_are_believed():
    truck = car(20.0, 2.0, size=(8.5, 2.6, 3.3))  # points up to 1.95 m
    low, camera = named(lidar_view(truck, score=0.7), "truck"), outline(truck, label="car")
    high = replace(low, xyz=low.xyz + np.array([0, 0, 0.5]))
    assert fuse(seen(camera, low), PARAMS).label.tolist() == ["car"]
    found = fuse(seen(camera, high), PARAMS)
    assert found.label.tolist() == ["truck"]
    assert found.size_lwh_m[0, 0] == 8.5
    assert fuse(seen(camera, replace(high, plane=None)), PARAMS).label.tolist() == ["car"]


def test_points_farther_apart_than_what_the_camera_names_are_believed():
    truck = car(20.0, 2.0, size=(8.5, 2.6, 3.3))
    rear, camera = named(lidar_view(truck, score=0.7), "truck"), outline(truck, label="van")
    side = np.array([[x, 3.3, -0.5] for x in np.arange(16.0, 23.5, 0.5)])
    whole = replace(rear, xyz=np.concatenate([rear.xyz, side]), cluster=np.zeros(30 + len(side), np.int64))
    assert fuse(seen(camera, rear), PARAMS).label.tolist() == ["van"]
    assert fuse(seen(camera, whole), PARAMS).label.tolist() == ["truck"]


@pytest.mark.parametrize(
    ("by_lidar", "score", "by_camera", "expected"),
    [("truck", 0.9, "van", "truck"), ("truck", 0.7, "van", "van"), ("car", 0.9, "truck", "truck"),
     ("truck", 0.9, "pedestrian", "pedestrian")],
)  # fmt: skip
def test_a_surer_lidar_is_believed_that_a_vehicle_is_larger(by_lidar, score, by_camera, expected):
    box = car(20.0, 2.0, size=(5.0, 2.0, 2.1))
    lidar = named(lidar_view(box, score=score), by_lidar)
    assert fuse(seen(outline(box, label=by_camera), lidar), PARAMS).label.tolist() == [expected]


@pytest.mark.parametrize(("score", "expected"), [(0.9, "bicycle"), (0.7, "motorcycle")])
def test_the_surer_of_a_network_on_points_and_a_camera_names_the_class(score, expected):
    box = car(15.0, 1.0, size=(1.8, 0.6, 1.7))
    camera, lidar = outline(box, label="motorcycle"), named(lidar_view(box, score=score), "bicycle")
    found = fuse(seen(camera, replace(lidar, learned=True)), PARAMS)
    assert found.label.tolist() == [expected]
    assert fuse(seen(camera, lidar), PARAMS).label.tolist() == ["motorcycle"]  # Clusters know sizes, not classes


def test_radar_that_sees_the_rear_of_a_truck_does_not_pull_it_nearer():
    truck = car(30.0, size=(8.5, 2.6, 3.3))
    rear = car(30.0 - 8.5 / 2 + 4.2 / 2)  # what radar takes it for: a car behind the same side
    alone = fuse(seen(None, named(lidar_view(truck), "truck")), PARAMS)
    both = fuse(seen(None, named(lidar_view(truck), "truck"), radar_view(rear)), PARAMS)
    assert both.sources.tolist() == [6]
    assert both.center_m[0, 0] == pytest.approx(alone.center_m[0, 0], abs=0.05)
    by_camera = fuse(seen(outline(truck, label="truck"), lidar_view(truck), radar_view(rear)), PARAMS)
    assert by_camera.center_m[0, 0] < both.center_m[0, 0] - 0.05  # it may be a van


def test_of_two_footprints_in_one_place_the_surer_one_stays():
    truck = car(30.0, size=(8.5, 2.6, 3.3))
    view = lidar_view(truck, car(34.5, 0.5))  # 2.35 m of it are inside
    sure = replace(view, boxes=replace(view.boxes, score=np.array([0.9, 0.8])))
    assert fuse(seen(None, sure), PARAMS).size_lwh_m[:, 0].tolist() == [8.5]
    beside = lidar_view(truck, car(34.5, 2.3))
    assert len(fuse(seen(None, beside), PARAMS)) == 2


def test_a_cluster_that_reaches_far_beyond_a_box_gives_what_is_inside():
    """A car before a hedge that is 30 m long, all in one cluster."""
    box = car(20.0)
    view, hedge = lidar_view(box, score=0.0), np.column_stack([np.full(60, 24.0), np.linspace(2, 32, 60), np.zeros(60)])
    joined = replace(view, xyz=np.concatenate([view.xyz, hedge]), cluster=np.zeros(90, np.int64))
    found = fuse(seen(outline(box), joined), PARAMS)
    assert found.sources.tolist() == [3]
    assert found.center_m[0, :2] == pytest.approx([20, 0], abs=0.5)


def weak(camera, score=0.3):
    """The same boxes, of which a detector that reports from 0.5 on isn't sure."""
    return replace(camera, score=np.full(len(camera), score), min_score=0.5)


def test_a_weak_box_is_not_reported_unless_another_sensor_confirms_it():
    box = car(20.0)
    assert len(fuse(seen(weak(outline(box))), PARAMS)) == 0
    assert len(fuse(seen(weak(outline(box)), None, standing_view(box)), PARAMS)) == 0
    without = fuse(seen(None, lidar_view(box, score=0.45)), PARAMS)
    found = fuse(seen(weak(outline(box)), lidar_view(box, score=0.45)), PARAMS)
    assert (without.sources.tolist(), found.sources.tolist()) == ([2], [3])
    assert found.score[0] > without.score[0]
    assert found.label.tolist() == ["car"]


def test_a_weak_box_takes_nothing_from_a_sure_one():
    box = car(20.0)
    sure, doubtful = outline(box), weak(outline(car(20.5, 0.2)))
    both = replace(
        doubtful,
        xyxy_px=np.concatenate([sure.xyxy_px, doubtful.xyxy_px]),
        score=np.array([0.6, 0.3]),
        label=np.array(["van", "car"]),
    )
    found = fuse(seen(both, lidar_view(box)), PARAMS)
    assert found.sources.tolist() == [3]
    assert found.label.tolist() == ["van"]


def test_what_covers_the_cameras_box_is_surer_than_what_does_not():
    box, small = car(20.0), car(20.0, size=(4.2, 1.2, 1.0))
    scores = [fuse(seen(outline(shown), lidar_view(box, score=0.3)), PARAMS).score[0] for shown in (box, small)]
    assert scores[0] > scores[1]
