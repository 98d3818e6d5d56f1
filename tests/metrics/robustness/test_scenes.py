"""Figures over several scenes, by hand."""

import pytest

from fbench.metrics.core.bootstrap import Bootstrap
from fbench.metrics.robustness.scenes import ScoredRun, change, difference, pool, spaces_of
from fbench.replay.data.scores import Score

IMAGE, GROUND = "iou 0.5, within 50 m", "bev 2 m, within 50 m, in view"


def f1(tp, fp, fn, matching=IMAGE):
    bottom = tp + fp / 2 + fn / 2
    value, reason = (tp / bottom, None) if bottom else (None, "no boxes")
    return Score("f1", "vehicle", "all", matching, value, reason, "1", {"tp": tp, "fp": fp, "fn": fn, "frames": 3})


def mota(gt, fn, fp, idsw, reason=None, metric="mota"):
    counts = {"tp": gt - fn, "fp": fp, "fn": fn, "gt": gt, "idsw": idsw}
    reason = reason or (None if gt else "no truth boxes")
    return Score(metric, "vehicle", "all", IMAGE, None if reason else 0.5, reason, "1", counts)


def run(*scores, condition="clear", scene="urban-1", configuration="lidar3d"):
    return ScoredRun(configuration, condition, scene, scores)


def test_counts_are_added_not_ratios_averaged():
    runs = [run(f1(8, 0, 2)), run(f1(0, 0, 90), scene="highway-1")]
    figure = pool(runs, "f1", "image")
    assert figure.value == pytest.approx(8 / (8 + 46))  # the mean of both would be 0.444
    assert figure.counts == {"tp": 8, "fp": 0, "fn": 92}


def test_mota_of_scenes_together():
    runs = [run(mota(10, 2, 3, 1)), run(mota(30, 5, 0, 0), scene="highway-1")]
    assert pool(runs, "mota", "image").value == pytest.approx(1 - (7 + 3 + 1) / 40)


def test_mota_without_false_positives():
    runs = [run(mota(10, 2, 3, 1, metric="mota_no_fp"))]
    assert pool(runs, "mota_no_fp", "image").value == pytest.approx(1 - 3 / 10)


def test_scenes_without_boxes_add_nothing_but_their_false_alarms():
    runs = [run(mota(10, 0, 0, 0)), run(mota(0, 0, 5, 0), scene="empty-1")]
    assert pool(runs, "mota", "image").value == pytest.approx(0.5)


def test_what_one_scene_leaves_undefined_is_undefined_in_all():
    figure = pool([run(mota(10, 0, 0, 0)), run(mota(4, 0, 0, 0, "tracks have no ids"))], "mota", "image")
    assert (figure.value, figure.reason) == (None, "tracks have no ids")


def test_nothing_to_divide_by_is_null_with_the_reason():
    assert pool([run(f1(0, 0, 0))], "f1", "image").reason == "no boxes"
    assert pool([], "f1", "image").reason == "no run"
    assert pool([run(f1(1, 1, 1))], "f1", "3D").reason == "no run"


def test_spaces_are_those_that_were_scored():
    assert spaces_of([run(f1(1, 0, 0))]) == ["image"]
    assert spaces_of([run(f1(1, 0, 0, GROUND), f1(1, 0, 0))]) == ["image", "3D"]


def test_other_classes_and_slices_play_no_part():
    other = Score("f1", "car", "all", IMAGE, 1.0, None, "1", {"tp": 5, "fp": 0, "fn": 0})
    part = Score("f1", "vehicle", "range 0-10 m", IMAGE, 1.0, None, "1", {"tp": 5, "fp": 0, "fn": 0})
    assert pool([run(other, part, f1(1, 0, 1))], "f1", "image").counts["tp"] == 1


@pytest.mark.parametrize(("metric", "head", "base"), [("f1", 8 / 10, 6 / 7.5), ("mota", 1 - 4 / 10, 1 - 6 / 10)])
def test_difference_is_of_the_metric_on_scenes_that_both_have(metric, head, base):
    one = [run(f1(8, 2, 2), mota(10, 2, 2, 0))]
    other = [run(f1(6, 1, 2), mota(10, 4, 2, 0)), run(f1(0, 9, 9), mota(10, 10, 0, 0), scene="highway-1")]
    figure = difference(one, other, "image", Bootstrap(), metric)
    assert figure.value == pytest.approx(head - base)
    assert (figure.low, figure.high) == (None, None), "one scene is too few for an interval"


def test_change_is_relative_to_clear():
    runs = [run(f1(8, 2, 2)), run(f1(4, 1, 6), condition="fog")]
    clear, fog = 0.8, 4 / 7.5
    figure = change(runs, "fog", "image")
    assert figure.value == pytest.approx(fog / clear - 1)
    assert figure.counts == {"clear_tp": 8, "clear_fp": 2, "clear_fn": 2, "then_tp": 4, "then_fp": 1, "then_fn": 6}


def test_change_compares_only_scenes_that_have_both():
    runs = [run(f1(8, 2, 2)), run(f1(0, 0, 100), scene="highway-1"), run(f1(4, 1, 6), condition="fog")]
    assert change(runs, "fog", "image").value == pytest.approx(4 / 7.5 / 0.8 - 1)


@pytest.mark.parametrize(
    ("runs", "reason"),
    [
        ([run(f1(0, 3, 5)), run(f1(4, 1, 6), condition="fog")], "F1 is 0 in clear, too little for a relative change"),
        (
            [run(f1(1, 9, 11)), run(f1(4, 1, 6), condition="fog")],
            "F1 is 0.0909 in clear, too little for a relative change",
        ),
        ([run(f1(0, 0, 0)), run(f1(4, 1, 6), condition="fog")], "no F1 in clear: no boxes"),
        ([run(f1(4, 1, 6)), run(f1(0, 0, 0), condition="fog")], "no F1 in fog: no boxes"),
        ([run(f1(4, 1, 6))], "no scene was run both in clear and in fog"),
        ([run(f1(1, 0, 0)), run(f1(1, 0, 0), condition="fog", scene="x")], "no scene was run both in clear and in fog"),
    ],
)
def test_change_is_null_where_nothing_can_be_said(runs, reason):
    figure = change(runs, "fog", "image")
    assert (figure.value, figure.reason) == (None, reason)
