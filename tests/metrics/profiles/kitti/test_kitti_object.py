"""The rules of `kitti-object` on frames small enough to count by hand, and what must not change its numbers."""

from dataclasses import fields, replace
from itertools import permutations

import numpy as np
import pytest
from tests.metrics.profiles.kitti.kitti_frames import object_sequence
from tests.metrics.profiles.kitti.oracles.kitti_objects_input import made_frames

from fbench.metrics.profiles.kitti.object import KittiObject
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.sequences import Objects, Sequence, Steps

PROFILE = KittiObject()
IOU2D = PROFILE.with_match(Match("iou2d", 0.7))


def boxes(*rows: tuple[str, float, float], score=(), height=100.0, **levels: float) -> Objects:
    """Cars 20 m ahead, (class, place [m] to the right, frame); rectangles are 60 px wide and `height` high."""
    label, x, frame = (np.array([row[i] for row in rows]) for i in range(3))
    zero, left = np.zeros(len(rows)), 600 + 40 * x
    return Objects(
        step=frame.astype(np.int64), label=label.astype(np.str_), track_id=np.full(len(rows), -1),
        score=np.array(score, float) if len(score) else zero,
        xyxy_px=np.column_stack([left, zero, left + 60, zero + height]),
        center_m=np.column_stack([zero + 20, -x, zero]), size_lwh_m=np.tile([4.0, 1.6, 1.5], (len(rows), 1)),
        yaw_rad=zero, occlusion=zero + levels.get("occlusion", 0), truncation=zero + levels.get("truncation", 0),
    )  # fmt: skip


def joined(*parts: Objects) -> Objects:
    names = [f.name for f in fields(Objects) if getattr(parts[0], f.name) is not None]
    both = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    order = np.argsort(both["step"], kind="stable")
    return Objects(**{name: values[order] for name, values in both.items()})


def sequence(truth: Objects, results: Objects, frames: int = 1) -> Sequence:
    return Sequence("0", Steps.of_one_stream(frames), truth, results)


def found(truth: Objects, results: Objects, profile=IOU2D, difficulty="moderate", frames=1, label="car"):
    rows = profile.scores(profile.measure(sequence(truth, results, frames)), "all")
    return {r.metric: r for r in rows if r.class_ == label and r.slice == f"all, {difficulty}"}


def test_truth_as_result_reaches_all_but_the_last_recall_it_has_scores_for():
    truth = boxes(*(("car", 0, f) for f in range(80)))
    results = boxes(*(("car", 0, f) for f in range(80)), score=np.arange(80) + 1)
    own = found(truth, results, frames=80)
    assert own["ap"].value == own["ap11"].value == 1
    assert own["aos"].value == own["aos11"].value == 1
    assert own["ap"].counts == {"tp": 80, "fp": 0, "fn": 0, "gt": 80, "reached": 41, "invalid_truth": 0,
                                "invalid_results": 0}  # fmt: skip


def test_ap_counts_forty_recalls_without_zero_and_ap11_eleven_with_it():
    # One of two truth boxes found: thresholds for recalls 0 only, so that 40 recalls give 0 and 11 give 1/11.
    own = found(boxes(("car", 0, 0), ("car", 10, 0)), boxes(("car", 0, 0), score=[1]))
    assert own["ap"].value == 0
    assert own["ap11"].value == pytest.approx(1 / 11, abs=1e-15)


def test_precision_is_the_best_from_each_recall_on():
    # 4 truth boxes: hit, false alarm, hit, hit, hit by falling score. The thresholds of recalls 0 to 3/40 are the hits;
    # precision is 1, 2/3, 3/4, 4/5 there, from each on at best 1, .8, .8, .8.
    truth = boxes(*(("car", 10 * i, 0) for i in range(4)))
    results = boxes(*(("car", x, 0) for x in (0, -20, 10, 20, 30)), score=[5, 4, 3, 2, 1])
    own = found(truth, results)
    assert own["ap"].value == pytest.approx(3 * 0.8 / 40, abs=1e-15)
    assert own["ap11"].value == pytest.approx(1 / 11, abs=1e-15)


@pytest.mark.parametrize(("height", "levels", "counted"), [
    (41, {}, "easy moderate hard"), (40, {}, "moderate hard"), (26, {}, "moderate hard"), (25, {}, ""),
    (100, {"occlusion": 1}, "moderate hard"), (100, {"occlusion": 2}, "hard"), (100, {"occlusion": 3}, ""),
    (100, {"truncation": 0.15}, "easy moderate hard"), (100, {"truncation": 0.16}, "moderate hard"),
    (100, {"truncation": 0.31}, "hard"), (100, {"truncation": 0.51}, ""),
])  # fmt: skip
def test_difficulties_say_what_must_be_found(height, levels, counted):
    truth, results = boxes(("car", 0, 0), height=height, **levels), boxes(("car", 9, 0), score=[1])
    for name in ("easy", "moderate", "hard"):
        assert found(truth, results, difficulty=name)["ap"].counts["gt"] == (name in counted.split())


def test_neighbors_low_results_and_regions_are_neutral():
    truth = boxes(("car", 0, 0), ("van", 10, 0), ("dontcare", 20, 0))
    tall = boxes(*(("car", x, 0) for x in (0, 10, 20)), score=[1, 3, 2])
    low = boxes(("car", 30, 0), ("cyclist", 40, 0), score=[4, 4], height=24)
    own = found(truth, joined(tall, low))
    assert own["ap11"].value == pytest.approx(1 / 11, abs=1e-15)
    assert [own["ap"].counts[name] for name in ("tp", "fp", "fn")] == [1, 0, 0]


def test_in_space_regions_excuse_nothing():
    truth = boxes(("car", 0, 0), ("dontcare", 20, 0))
    results = boxes(("car", 0, 0), ("car", 20, 0), score=[1, 2])
    assert found(truth, results, PROFILE.with_match(Match("iou3d", 0.7)))["ap"].counts["fp"] == 1


def test_a_low_result_of_any_class_can_take_a_truth_box():
    # the devkit looks at the height before the class: the low cyclist takes the car, which is no miss then
    truth = boxes(("car", 0, 0), ("car", 10, 0), height=26)
    results = joined(boxes(("cyclist", 0, 0), score=[3], height=24), boxes(("car", 10, 0), score=[1], height=26))
    own = found(truth, results)["ap"]
    assert [own.counts[name] for name in ("tp", "fp", "fn")] == [1, 0, 0]


def test_without_truth_or_results_values_are_null_or_zero():
    own = found(boxes(("cyclist", 0, 0)), boxes(("car", 0, 0), score=[1]))
    assert own["ap"].value is None
    assert own["ap"].reason == "no truth boxes of this difficulty (KITTI's devkit prints 0)"
    own = found(boxes(("car", 0, 0)), boxes(("cyclist", 0, 0)))
    assert own["ap"].value == 0
    assert own["ap"].counts["fn"] == 1


def test_what_boxes_lack_gives_null():
    truth, results = boxes(("car", 0, 0)), boxes(("car", 0, 0), score=[1])
    flat = replace(results, center_m=None, size_lwh_m=None, yaw_rad=None)
    rows = {r.matching: r for r in PROFILE.scores(PROFILE.measure(sequence(truth, flat)), "all") if r.metric == "ap11"}
    assert rows["iou3d 0.7"].reason == "results of 0: no 3D boxes"
    own = found(truth, flat)
    assert own["aos"].reason == "no observation angles"
    assert own["ap11"].value > 0


def test_results_that_are_no_boxes_are_false_positives_at_every_threshold():
    truth, results = boxes(("car", 0, 0)), boxes(("car", 0, 0), ("car", 10, 0), ("car", 20, 0), score=[1, 0, np.nan])
    xyxy = np.array(results.xyxy_px)
    xyxy[1] = [700, 100, 600, 200]
    own = found(truth, replace(results, xyxy_px=xyxy))["ap"]
    assert own.counts["fp"] == 2
    assert own.counts["invalid_results"] == 2


def test_truth_without_a_size_is_left_out_and_counted():
    truth = boxes(("car", 0, 0), ("car", 10, 0))
    size = np.array(truth.size_lwh_m)
    size[1, 0] = -4
    own = found(
        replace(truth, size_lwh_m=size), boxes(("car", 0, 0), score=[1]), PROFILE.with_match(Match("iou3d", 0.7))
    )
    assert own["ap"].counts["gt"] == 1
    assert own["ap"].counts["invalid_truth"] == 1


def test_distances_are_refused():
    with pytest.raises(ConfigError, match="expected iou2d, ioubev or iou3d"):
        PROFILE.with_match(Match("bev", 2))


def test_grouping_order_of_sequences_and_of_results_change_nothing():
    frames = made_frames(3, 30)
    parts = [PROFILE.measure(object_sequence(str(i), frames[i::3])) for i in range(3)]
    wanted = PROFILE.scores(parts[0] + parts[1] + parts[2], "all")
    for a, b, c in permutations(parts):
        assert PROFILE.scores(a + (b + c), "all") == wanted
    whole = object_sequence("0", frames)
    rng = np.random.default_rng(1)
    order = np.lexsort((rng.random(len(whole.estimates)), whole.estimates.step))
    shuffled = replace(whole, estimates=whole.estimates[order])
    assert PROFILE.scores(PROFILE.measure(shuffled), "all") == PROFILE.scores(PROFILE.measure(whole), "all")


def test_sorted_rows_make_the_order_of_truth_irrelevant_where_boxes_compete():
    profile, rng = KittiObject(sort=True), np.random.default_rng(2)
    whole = object_sequence("0", made_frames(4, 30, 2.0))
    orders = [np.lexsort((rng.random(len(side)), side.step)) for side in (whole.truth, whole.estimates)]
    shuffled = replace(whole, truth=whole.truth[orders[0]], estimates=whole.estimates[orders[1]])
    assert profile.scores(profile.measure(shuffled), "all") == profile.scores(profile.measure(whole), "all")
    assert PROFILE.scores(PROFILE.measure(shuffled), "all") != PROFILE.scores(PROFILE.measure(whole), "all")


def test_sorted_rows_are_told_apart_by_all_that_decides():
    profile, result = KittiObject(sort=True).with_match(Match("iou2d", 0.7)), boxes(("car", 0, 0), score=[0.5])
    here = ("car", 0, 0)
    for others in (
        [boxes(here, ("van", 0, 0)), boxes(("van", 0, 0), here)],
        [replace(boxes(here, here), occlusion=np.array(levels)) for levels in ([0.0, 3], [3.0, 0])],
        [replace(boxes(here, here), alpha_rad=np.array(angles)) for angles in ([0.0, 3], [3.0, 0])],
    ):
        seen = [found(truth, replace(result, alpha_rad=np.zeros(1)), profile) for truth in others]
        assert seen[0] == seen[1]
