"""What can be chosen beside the thesis's filters."""

from dataclasses import replace

import numpy as np
import pytest

from fbench.pipelines.tracking.params import Tracker2DParams, Tracker3DParams
from fbench.pipelines.tracking.trackers import Tracker2D, Tracker3D
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.geometry.iou import move_boxes
from fbench.replay.geometry.transforms import inverse

MS = 1_000_000


def cars(*xy, yaw=0.0, score=0.9, label="car"):
    num = len(xy)
    place = np.array(xy, np.float64).reshape(-1, 2)
    return Boxes3D(
        np.column_stack([place, np.full(num, 0.8)]), np.tile([4.0, 1.8, 1.6], (num, 1)), np.full(num, yaw),
        label=np.full(num, label), score=np.full(num, score),
    )  # fmt: skip


def flat(*x, score=0.9, size=40.0, **more):
    num = len(x)
    left = np.array(x, np.float64)
    xyxy = np.column_stack([left, np.full(num, 100.0), left + size, np.full(num, 100.0 + size)])
    return Boxes2D(np.full(num, "front"), xyxy, label=np.full(num, "car"), score=np.full(num, score), **more)


def tracked(found, step_ms=100, **params):
    tracker = Tracker3D(Tracker3DParams(**{"min_hits": 1} | params))
    return [tracker.step(boxes, (i + 1) * step_ms * MS, None) for i, boxes in enumerate(found)]


def tracked_flat(found, **params):
    tracker = Tracker2D(Tracker2DParams(**{"min_hits": 1, "max_missed_shown": 2} | params))
    return [tracker.step(boxes, (i + 1) * 100 * MS) for i, boxes in enumerate(found)]


def ids(shown):
    return [boxes.track_id.tolist() for boxes in shown]


@pytest.mark.parametrize("association", ["distance", "iou", "giou", "mahalanobis"])
def test_every_association_follows_two_cars(association):
    found = [cars((1.0 * i, 0.0), (40 - 1.0 * i, 3.5)) for i in range(12)]
    assert ids(tracked(found, association=association)) == [[1, 2]] * 12
    empty = tracked([cars(), cars((1.0, 0.0)), cars()], association=association)
    assert ids(empty) == [[], [1], [1]]


@pytest.mark.parametrize(("per_missed", "shown"), [(0, 3), (1, 3), (2, 2), (3, 1), (4, 1), (5, 0)])
def test_the_oftener_it_was_measured_the_longer_a_track_is_shown_without(per_missed, shown):
    """Four measurements, then none; with 0 only `max_missed_shown` counts."""
    found = [*[cars((1.0 * i, 0.0)) for i in range(4)], *[cars()] * 4]
    options = {"hits_per_missed": per_missed, "max_missed": 3, "max_missed_shown": 3}
    assert ids(tracked(found, **options)) == [[1]] * (4 + shown) + [[]] * (4 - shown)


@pytest.mark.parametrize("association", ["iou", "giou", "mahalanobis"])
def test_every_association_follows_two_boxes(association):
    found = [flat(10.0 + 4 * i, 400.0 - 4 * i) for i in range(12)]
    assert ids(tracked_flat(found, association=association)) == [[1, 2]] * 12
    assert ids(tracked_flat([flat(), flat(5.0), flat()], association=association)) == [[], [1], [1]]


def test_giou_joins_what_is_near_without_overlap():
    found = [cars((10.0, 0.0)), cars((14.5, 0.0))]
    assert ids(tracked(found, association="iou"))[1] == [1, 2]
    assert ids(tracked(found, association="giou"))[1] == [1]
    assert ids(tracked([cars((10.0, 0.0)), cars((24.0, 0.0))], association="giou"))[1] == [1, 2]
    apart = [flat(100.0), flat(145.0)]
    assert ids(tracked_flat(apart))[1] == [1, 2]
    assert ids(tracked_flat(apart, association="giou"))[1] == [1]


def slim(x=None, label="bicycle"):
    """A box 0.6 m wide that stands across, or none; 1.5 m to the side its generalized overlap with itself is -0.43."""
    boxes = cars(*(() if x is None else ((x, 0.0),)), yaw=np.pi / 2, label=label)
    return replace(boxes, size_lwh_m=np.tile([1.8, 0.6, 1.7], (len(boxes), 1)))


def test_giou_begins_tracks_of_slim_objects_that_move_farther_than_they_overlap():
    """The second measurement is within reach: it gives a velocity. The third confirms it."""
    found = [slim(1.5 * i) for i in range(6)]
    followed = tracked(found, association="giou", min_hits=2)
    assert ids(followed) == [[1], [], [1], [1], [1], [1]]
    assert followed[-1].velocity_mps[0, 0] == pytest.approx(15.0, abs=0.5)
    assert ids(tracked(found, association="giou", min_hits=2, new_gate_mps=14.0)) == [[1]] + [[]] * 5
    assert ids(tracked(found, association="giou")) == [[1]] * 6  # tracks that are shown at once go on at once
    faster = [slim(2.5 * i) for i in range(6)]
    assert ids(tracked(faster, association="giou", min_hits=2)) == [[1]] + [[]] * 5
    walkers = [slim(1.5 * i, label="pedestrian") for i in range(6)]
    assert ids(tracked(walkers, association="giou", min_hits=2)) == [[1]] + [[]] * 5
    assert ids(tracked(walkers, association="giou", min_hits=2, pedestrian_gate_mps=20.0))[2:] == [[1]] * 4


def test_what_is_only_within_reach_of_a_new_track_starts_a_track_of_its_own():
    """A false detection beside an object that stands doesn't delay the object's track."""
    found = [slim(0.0), *[slim(1.5)] * 4]
    assert ids(tracked(found, association="giou", min_hits=2)) == [[1], [], [2], [2], [2]]
    weak = [slim(0.0), *[replace(slim(1.5), score=np.array([0.1]))] * 4]
    assert ids(tracked(weak, association="giou", min_hits=2, weak_score=0.5)) == [[1], [], [], [], []]


def test_a_confirmed_track_takes_what_is_within_reach_after_a_gap():
    found = [*[slim(0.0)] * 5, slim(), slim(1.2)]
    last = tracked(found, association="giou", min_hits=2)[-1]
    assert (last.track_id.tolist(), last.predicted.tolist()) == ([1], [False])
    last = tracked(found, association="giou", min_hits=2, gate_mps=5.0)[-1]
    assert (last.track_id.tolist(), last.predicted.tolist()) == ([1], [True])


def test_mahalanobis_trusts_a_settled_track_less_far_than_a_new_one():
    still = [cars((10.0, 0.0))] * 10
    assert ids(tracked([cars((10.0, 0.0)), cars((13.0, 0.0))], association="mahalanobis"))[1] == [1]
    assert ids(tracked([*still, cars((13.0, 0.0))], association="mahalanobis"))[-1] == [1, 2]


def test_weak_detections_go_on_with_tracks_and_begin_none():
    weak = cars((30.0, 0.0), score=0.2)
    assert ids(tracked([weak, weak, weak], weak_score=0.5)) == [[], [], []]
    hidden = [cars((10.0, 0.0)), cars((10.5, 0.0), score=0.2), cars((11.0, 0.0))]
    shown = tracked(hidden, weak_score=0.5)
    assert ids(shown) == [[1]] * 3
    assert [boxes.predicted.tolist() for boxes in shown] == [[False]] * 3
    # The strong one counts first, though the weak one is nearer.
    both = replace(cars((10.0, 0.0), (11.0, 0.0)), score=np.array([0.2, 0.9]))
    last = tracked([cars((10.0, 0.0)), both], weak_score=0.5)[-1]
    assert last.track_id.tolist() == [1]
    assert last.score.tolist() == [0.9]
    assert ids(tracked_flat([flat(10.0), flat(12.0, score=0.2), flat(300.0, score=0.2)], weak_score=0.5)) == [[1]] * 3


def test_mean_score_and_that_of_predicted_tracks():
    found = [cars((10.0, 0.0), score=s) for s in (0.9, 0.5, 0.1)] + [cars()]
    scores = [boxes.score[0] for boxes in tracked(found, score="mean", predicted_share=0.5)]
    np.testing.assert_allclose(scores, [0.9, 0.7, 0.5, 0.25])
    assert [boxes.score[0] for boxes in tracked(found)] == [0.9, 0.5, 0.1, 0.1]
    images = [flat(10.0, score=s) for s in (0.9, 0.5, 0.1)] + [flat()]
    scores = [boxes.score[0] for boxes in tracked_flat(images, score="mean", predicted_share=0.5)]
    np.testing.assert_allclose(scores, [0.9, 0.7, 0.5, 0.25])


def test_scores_below_zero_name_their_label_too():
    shown = tracked([cars((10.0, 0.0), score=-0.5)] * 3)
    assert [boxes.label.tolist() for boxes in shown] == [["car"]] * 3


def test_size_and_heading_are_smoothed_and_a_flip_by_pi_changes_nothing():
    yaws = [0.3, 0.3 + np.pi, 0.3 - np.pi, 0.3, 0.34]
    found = [
        replace(cars((10.0, 0.0), yaw=yaw), size_lwh_m=np.array([[4.0 + i, 1.8, 1.6]])) for i, yaw in enumerate(yaws)
    ]
    last = tracked(found, size_share=0.0, yaw_share=0.25)[-1]
    np.testing.assert_allclose(last.yaw_rad, [0.31])
    np.testing.assert_allclose(last.size_lwh_m, [[6.0, 1.8, 1.6]])
    last = tracked(found)[-1]
    assert (last.yaw_rad.tolist(), last.size_lwh_m[0, 0]) == ([0.34], 8.0)


def test_ego_motion_is_compensated_unless_told_otherwise():
    shown = {}
    for ego_motion in (True, False):
        tracker = Tracker3D(Tracker3DParams(min_hits=1, ego_motion=ego_motion))
        for i in range(8):
            pose = np.eye(4)
            pose[0, 3] = 1.0 * i
            boxes = tracker.step(move_boxes(cars((30.0, 0.0)), inverse(pose)), (i + 1) * 100 * MS, pose)
        shown[ego_motion] = boxes.velocity_mps[0, 0]
    assert shown[True] == pytest.approx(0, abs=1e-9)
    assert shown[False] == pytest.approx(-10, abs=0.3)


def test_between_detections_tracks_are_predicted_and_miss_nothing():
    tracker = Tracker3D(Tracker3DParams(max_coast_s=2.0))
    assert len(tracker.predict(50 * MS, None)) == 0
    for i in range(6):
        tracker.step(cars((2.0 * i, 0.0)), (i + 1) * 200 * MS, None)
        shown = [tracker.predict((i + 1) * 200 * MS + k * 20 * MS, None) for k in range(1, 8)]
    assert ids(shown) == [[1]] * 7
    assert all(boxes.predicted.all() for boxes in shown)
    np.testing.assert_allclose(shown[4].center_m[0], [11.0, 0, 0.8], atol=0.1)
    late = tracker.step(cars((12.0, 0.0)), 1400 * MS, None)
    assert (late.track_id.tolist(), late.predicted.tolist()) == ([1], [False])


def test_distance_moves_by_signed_range_rate_between_detections():
    tracker = Tracker2D(Tracker2DParams(min_hits=1))
    assert len(tracker.predict(50 * MS)) == 0
    ranged = flat(10.0, 200.0, distance_m=np.array([20.0, 30.0]), range_rate_mps=np.array([-5.0, 4.0]))
    tracker.step(ranged, 100 * MS)
    shown = tracker.predict(200 * MS)
    np.testing.assert_allclose(shown.distance_m, [19.5, 30.4])
    np.testing.assert_allclose(shown.range_rate_mps, [-5.0, 4.0])
    assert shown.predicted.tolist() == [True, True]
    np.testing.assert_allclose(tracker.step(flat(10.0, 200.0), 300 * MS).distance_m, [19.0, 30.8])


@pytest.mark.parametrize("association", ["distance", "iou", "giou", "mahalanobis"])
def test_a_rigid_motion_of_the_world_moves_the_tracks_with_it(association):
    rng = np.random.default_rng(3)
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]]
    turn[:2, 3] = [300.0, -80.0]
    place, speed = rng.uniform(-30, 30, (8, 2)), rng.uniform(-6, 6, (8, 2))
    found = [
        cars(*(place + speed * 0.1 * i + rng.normal(0, 0.1, (8, 2)))[rng.random(8) < 0.8], yaw=0.2) for i in range(15)
    ]
    params = {"association": association, "size_share": 0.2, "yaw_share": 0.2}
    here, there = tracked(found, **params), tracked([move_boxes(boxes, turn) for boxes in found], **params)
    for own, other in zip(here, there, strict=True):
        expected = move_boxes(own, turn)
        assert own.track_id.tolist() == other.track_id.tolist()
        np.testing.assert_allclose(other.center_m, expected.center_m, atol=1e-7)
        np.testing.assert_allclose(other.velocity_mps, expected.velocity_mps, atol=1e-7)
        np.testing.assert_allclose(np.cos(other.yaw_rad - expected.yaw_rad), 1, atol=1e-9)
