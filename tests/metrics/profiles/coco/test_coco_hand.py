"""Values that can be followed by hand."""

import numpy as np
import pytest

from fbench.metrics.profiles.coco.profile import CocoProfile
from fbench.replay.contracts.errors import ConfigError, MetricError
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Objects, Sequence, Steps

Rectangle = tuple[float, float, float, float]
Values = np.ndarray | list[int] | list[float] | list[bool] | float
Labels = list[str] | str
SQUARE = (0.0, 0.0, 10.0, 10.0)
FAR = (100.0, 0.0, 110.0, 10.0)
AWAY = (300.0, 300.0, 310.0, 310.0)


def boxes(
    *rectangles: Rectangle, step: Values = 0, label: Labels = "car", score: Values = 0.0, ignore: Values = False
) -> Objects:
    n = len(rectangles)
    return Objects(
        np.broadcast_to(step, n).astype(np.int64), np.broadcast_to(label, n), np.full(n, -1),
        np.broadcast_to(score, n).astype(float), np.array(rectangles, float).reshape(n, 4),
        ignore=np.broadcast_to(ignore, n).astype(bool),
    )  # fmt: skip


def rows(truth: Objects, estimates: Objects, num_steps: int = 1, profile: CocoProfile | None = None) -> list[Score]:
    profile = profile or CocoProfile()
    return profile.scores(profile.measure(Sequence("s", Steps.of_one_stream(num_steps), truth, estimates)), "all")


def row(found: list[Score], metric: str, class_: str = "all") -> Score:
    return next(s for s in found if (s.metric, s.class_) == (metric, class_))


def test_one_hit_is_perfect() -> None:
    found = rows(boxes(SQUARE), boxes(SQUARE, score=0.5))
    assert [s.metric for s in found[:12]] == [
        "ap", "ap50", "ap75", "aps", "apm", "apl", "ar1", "ar10", "ar100", "ars", "arm", "arl"
    ]  # fmt: skip
    assert [s.value for s in found[:12]] == [1, 1, 1, 1, None, None, 1, 1, 1, 1, None, None]
    assert row(found, "apm").reason == "no truth boxes (pycocotools prints -1)"
    assert (row(found, "ap").counts["tp"], row(found, "ap50").counts["tp"]) == (10, 1)


def test_a_false_alarm_before_the_hit_halves_precision() -> None:
    found = rows(boxes(SQUARE), boxes(AWAY, SQUARE, score=[0.9, 0.5]))
    assert row(found, "ap").value == pytest.approx(0.5)
    assert row(found, "ar1").value == 0
    assert row(found, "ar10").value == 1


def test_half_of_the_truth_gives_51_of_101_recalls() -> None:
    assert row(rows(boxes(SQUARE, FAR), boxes(SQUARE, score=0.5)), "ap").value == pytest.approx(51 / 101)


def test_thresholds_are_averaged() -> None:
    found = rows(boxes(SQUARE), boxes((0, 0, 10, 7.2), score=0.5))  # IoU 0.72
    assert row(found, "ap").value == pytest.approx(0.5)
    assert (row(found, "ap50").value, row(found, "ap75").value) == (1, 0)


def test_the_best_overlap_may_go_to_the_better_score_only() -> None:
    # Both lie on the square; the second finds nothing that is free.
    found = rows(boxes(SQUARE, FAR), boxes(SQUARE, (0, 0, 10, 9), score=[0.5, 0.6]))
    assert row(found, "ap50").counts["tp"] == 1
    assert row(found, "ap50").value == pytest.approx(51 / 101)


def test_a_crowd_excuses_what_lies_in_it_by_half() -> None:
    crowd = boxes(SQUARE, (200, 0, 300, 100), ignore=[False, True])
    inside, outside = (210, 10, 220, 20), (295, 0, 305.5, 10)
    excused = rows(crowd, boxes(SQUARE, inside, inside, score=[0.5, 0.9, 0.8]))
    assert row(excused, "ap").value == 1
    assert row(rows(crowd, boxes(SQUARE, outside, score=[0.5, 0.9])), "ap").value == pytest.approx(0.5)
    assert row(excused, "ap").counts["truth"] == 1


def test_counted_truth_comes_before_a_crowd() -> None:
    truth = boxes(SQUARE, SQUARE, ignore=[True, False])
    found = rows(truth, boxes((0, 0, 10, 6), score=0.5))  # IoU 0.6, but wholly in the crowd
    assert row(found, "ap50").counts["tp"] == 1


def test_areas_hold_both_their_ends() -> None:
    small = boxes((0, 0, 32, 32))
    assert [row(rows(small, small), name).value for name in ("aps", "apm", "apl")] == [1, 1, None]
    medium = boxes((0, 0, 96, 96))
    assert [row(rows(medium, medium), name).value for name in ("aps", "apm", "apl")] == [None, 1, 1]


def test_boxes_of_another_size_are_ignored_on_both_sides() -> None:
    truth = boxes(SQUARE, (200, 0, 300, 100))
    found = rows(truth, boxes(SQUARE, (200, 0, 300, 100), (400, 0, 500, 100), score=[0.5, 0.9, 0.8]))
    assert row(found, "aps").value == 1
    assert row(found, "aps").counts["fp"] == 0
    assert row(found, "apl").counts["fp"] == 10


def test_beyond_a_hundred_of_a_class_in_an_image_nothing_counts() -> None:
    score = np.linspace(0.9, 0.1, 101)
    last = rows(boxes(SQUARE), boxes(*[AWAY] * 100, SQUARE, score=score))
    assert (row(last, "ap").value, row(last, "ar100").value) == (0, 0)
    other = rows(boxes(SQUARE), boxes(*[AWAY] * 100, SQUARE, score=score, step=[0] * 100 + [1]), num_steps=2)
    assert row(other, "ap").counts["estimates"] == 101


def test_classes_are_averaged_if_truth_has_them() -> None:
    truth = boxes(SQUARE, FAR, label=["car", "van"])
    found = rows(truth, boxes(SQUARE, AWAY, label=["car", "bus"], score=0.5))
    assert row(found, "ap").value == pytest.approx(0.5)
    assert (row(found, "ap", "car").value, row(found, "ap", "van").value) == (1, 0)
    assert not [s for s in found if s.class_ == "bus"]
    chosen = rows(truth, boxes(SQUARE, score=0.5), profile=CocoProfile(classes=("bus", "car")))
    assert row(chosen, "ap").value == 1
    assert row(chosen, "ap", "bus").reason == "no truth boxes (pycocotools prints -1)"


def test_estimates_that_are_no_boxes_are_false_alarms_of_every_size() -> None:
    bad = [(np.nan, 0, 10, 10), (0, 0, np.inf, 10), (10, 10, 0, 0), SQUARE]
    estimates = boxes(SQUARE, *bad, score=[0.1, 0.5, 0.6, 0.7, np.nan])
    found = rows(boxes(SQUARE, (200, 0, 300, 100)), estimates)
    assert row(found, "ap50").counts["fp"] == 4
    assert row(found, "ap50").counts["invalid_estimates"] == 4
    assert row(found, "aps").counts["fp"] == row(found, "apl").counts["fp"] == 40
    assert row(found, "ap50").value == pytest.approx(51 / 101 / 4)


def test_truth_that_is_no_box_is_left_out_and_counted() -> None:
    found = rows(boxes(SQUARE, (np.nan, 0, 1, 1), (5, 5, 1, 1)), boxes(SQUARE, score=0.5))
    assert row(found, "ap").value == 1
    assert row(found, "ap").counts["invalid_truth"] == 2


def test_nothing_at_all_is_null() -> None:
    for estimates in (boxes(), boxes(SQUARE, score=0.5)):
        found = rows(boxes(), estimates)
        assert len(found) == 12
        assert all(s.value is None and s.reason for s in found)
    assert row(rows(boxes(SQUARE), boxes()), "ap").value == 0


def test_equal_scores_stand_by_content_not_by_order() -> None:
    truth = boxes(SQUARE, FAR)
    some = [SQUARE, FAR, AWAY, (0, 0, 10, 8)]
    values = {
        row(rows(truth, boxes(*[some[i] for i in order], score=0.5)), "ap").value
        for order in ([0, 1, 2, 3], [3, 2, 1, 0], [2, 0, 3, 1])
    }
    assert len(values) == 1


def test_another_threshold() -> None:
    profile = CocoProfile().with_match(Match.parse("iou2d:0.7"))
    found = rows(boxes(SQUARE), boxes((0, 0, 10, 7.2), score=0.5), profile=profile)
    assert row(found, "ap").value == 1
    assert row(found, "ap").matching == "iou2d 0.7, 100 an image"
    assert not [s for s in found if s.metric == "ap50"]
    exact = rows(boxes(SQUARE), boxes(SQUARE, score=0.5), profile=CocoProfile().with_match(Match("iou2d", 1.0)))
    assert row(exact, "ap").value == 1
    with pytest.raises(ConfigError, match="can't match by bev"):
        CocoProfile().with_match(Match.parse("bev:2"))


def test_boxes_without_rectangles_are_refused() -> None:
    solid = Objects(
        np.zeros(1, np.int64), np.array(["car"]), np.zeros(1, np.int64), np.ones(1),
        center_m=np.zeros((1, 3)), size_lwh_m=np.ones((1, 3)), yaw_rad=np.zeros(1),
    )  # fmt: skip
    with pytest.raises(MetricError):
        rows(solid, solid)
