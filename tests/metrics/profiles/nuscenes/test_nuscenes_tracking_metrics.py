"""Tracking on nuScenes, by hand."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from tests.metrics.profiles.nuscenes.nuscenes_sequences import find, of_scene, row, sequence
from tests.metrics.profiles.nuscenes.oracles.nuscenes_scenes import TRACKING_PLANS, Row, scenes_of

from fbench.metrics.profiles.nuscenes.clips import TrackingStatistics
from fbench.metrics.profiles.nuscenes.tracking import NuscenesTracking
from fbench.replay.contracts.errors import ConfigError, MetricError
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence, Steps

PROFILE = NuscenesTracking()


def scores(*sequences: Sequence) -> list[Score]:
    total = PROFILE.measure(sequences[0])
    for other in sequences[1:]:
        total += PROFILE.measure(other)
    return PROFILE.scores(total, "all")


def car(step: int, own: int, x: float, **changes: object) -> Row:
    return row(step, "car", own, x, **changes)


def values(rows: list[Score], *metrics: str, class_: str = "car") -> list[float | None]:
    return [find(rows, metric, class_).value for metric in metrics]


def test_identity_is_perfect() -> None:
    truth = [car(s, own, 10.0 * own) for s in range(4) for own in range(3)]
    rows = scores(sequence(truth, truth, 4))
    for class_ in ("car", "all"):
        assert values(rows, "amota", "mota", "recall", "motar", class_=class_) == [1, 1, 1, 1]
        assert values(rows, "amotp", "motp", "fp", "fn", "ids", "frag", class_=class_) == [0, 0, 0, 0, 0, 0]
        assert values(rows, "gt", "tp", "mt", "ml", "tid", "lgd", class_=class_) == [12, 12, 3, 0, 0, 0]
    assert find(rows, "amota", "bus").reason == "no truth boxes (nuscenes-devkit prints nan)"


def test_recalls_go_from_a_tenth_to_one_and_those_unreached_count_the_worst() -> None:
    """One of two tracks is found: recalls up to 0.5 are reached, 18 of 40 (0.1 + 0.9 / 39 * k)."""
    truth = [car(s, own, 10.0 * own) for s in range(5) for own in range(2)]
    rows = scores(sequence(truth, [car(s, 7, 1.0) for s in range(5)], 5))
    reached = int((np.linspace(0.1, 1, 40).round(12) <= 0.5).sum())
    assert reached == 18
    assert find(rows, "amota", "car").counts["recalls_reached"] == reached
    assert values(rows, "amota") == [pytest.approx(reached / 40)]  # MOTAR is 1 where it is reached
    assert values(rows, "amotp") == [pytest.approx((reached * 1.0 + (40 - reached) * 2.0) / 40)]
    assert values(rows, "mota", "recall", "ml", "mt", "fn") == [0.5, 0.5, 1, 1, 5]


def test_mota_is_floored_and_taken_where_it_is_best() -> None:
    """With the poor track, MOTA would be 1/4 - 9/4; without it, it is 1/4."""
    truth = [car(s, 0, 0.0) for s in range(4)]
    good = [car(0, 5, 0.0, score=0.9)]
    bad = [car(s, 10 + i, -30.0 - 5 * i, score=0.2) for s in range(3) for i in range(3)]
    rows = scores(sequence(truth, good + bad, 4))
    assert values(rows, "mota", "fp", "tp") == [0.25, 0, 1]
    all_bad = [{**one, "score": 0.95} for one in bad]
    assert values(scores(sequence(truth, good + all_bad, 4)), "mota", "motar", "fp") == [0, 0, 9]


def test_switch_is_kept_out_of_tp_but_counts_for_recall() -> None:
    truth = [car(s, 0, 0.0) for s in range(4)]
    results = [car(s, 1 + s // 2, 0.1) for s in range(4)]
    rows = scores(sequence(truth, results, 4))
    assert values(rows, "tp", "ids", "fn", "recall", "mota", "mt") == [3, 1, 0, 1, 0.75, 1]
    assert values(rows, "motar") == [pytest.approx(1 - (1 - 0.25 * 4) / 3)]


def test_switch_is_seen_over_any_gap() -> None:
    truth = [car(s, 0, 0.0) for s in range(6)]
    rows = scores(sequence(truth, [car(0, 1, 0.0), car(5, 2, 0.0)], 6))
    assert values(rows, "ids", "frag", "tid", "lgd") == [1, 1, 0, 2.0]


def test_track_goes_on_with_its_partner_though_another_is_nearer() -> None:
    truth = [car(s, 0, 0.0) for s in range(2)]
    results = [car(0, 1, 0.0), car(1, 1, 1.5), car(1, 2, 0.1)]
    rows = scores(sequence(truth, results, 2))
    assert values(rows, "ids", "fp", "motp") == [0, 1, 0.75]


def test_two_that_want_to_go_on_with_one_track_are_decided_by_place() -> None:
    """Truth 0 has track 1, then truth 1 has; when both are near it again, the one at the lower x goes on."""
    truth = [car(0, 0, 0.0), car(2, 0, 0.5), car(1, 1, 5.0), car(2, 1, 1.0), car(1, 0, -9.0), car(0, 1, 20.0)]
    results = [car(0, 1, 0.0), car(1, 1, 5.0), car(2, 1, 0.9)]
    for given in (truth, truth[::-1], sorted(truth, key=lambda r: -r["id"])):
        rows = scores(sequence(given, results, 3))
        assert values(rows, "motp") == [pytest.approx(0.4 / 3)]


def test_two_metres_is_too_far() -> None:
    rows = scores(sequence([car(0, 0, 0.0)], [car(0, 0, 2.0)]))
    assert values(rows, "amota", "amotp", "mota", "recall", "tp", "fn", "ml") == [0, 2, 0, 0, 0, 1, 1]
    assert values(rows, "faf", "motp", "tid", "lgd") == [500, 2, 20, 20]
    for metric in ("fp", "ids", "frag"):
        assert find(rows, metric, "car").reason == "nothing matched (nuscenes-devkit prints nan)"
        assert find(rows, metric).reason == "nothing matched in any class (nuscenes-devkit prints 0)"


def test_gaps_are_filled_on_both_sides() -> None:
    ends = [car(0, 0, 0.0), car(2, 0, 4.0)]
    rows = scores(sequence(ends, [car(s, 1, 2.0 * s) for s in range(3)], 3))
    assert values(rows, "gt", "tp", "fp", "motp") == [3, 3, 0, 0]
    rows = scores(sequence([car(s, 1, 2.0 * s) for s in range(3)], ends, 3))
    assert values(rows, "gt", "tp", "fn", "motp") == [3, 3, 0, 0]


def test_gaps_are_filled_with_the_weights_the_wrong_way_round() -> None:
    """At a third of the way, 3 m on, the devkit puts the box at two thirds."""
    ends = [car(0, 0, 0.0), car(3, 0, 3.0)]
    rows = scores(sequence(ends, [car(s, 1, 1.0 * s) for s in range(4)], 4))
    assert values(rows, "motp") == [pytest.approx((0 + 1 + 1 + 0) / 4)]


def test_gaps_are_filled_by_time_within_a_stream() -> None:
    steps = Steps(np.arange(3), np.array([0, 3, 4]) * 1_000_000_000, np.zeros(3, np.int64))
    ends = [car(0, 0, 0.0), car(2, 0, 4.0)]
    one = replace(sequence(ends, [car(1, 1, 1.0)], 3), steps=steps)
    assert values(scores(one), "gt", "motp") == [3, pytest.approx(0.0)]
    apart = replace(one, steps=replace(steps, stream=np.array([0, 0, 1])))
    assert values(scores(apart), "gt", "fp", "ml") == [2, None, 2]
    frames_only = replace(one, steps=replace(steps, stamp_ns=np.zeros(3, np.int64)))
    assert values(scores(frames_only), "gt", "motp") == [3, pytest.approx(1.0)]
    with pytest.raises(MetricError, match="sample 2: not later than the sample before it"):
        scores(replace(one, steps=replace(steps, stamp_ns=np.array([0, 5, 5]))))


def test_score_of_a_track_is_its_mean() -> None:
    truth = [car(s, 0, 0.0) for s in range(3)]
    results = [car(s, 1, 0.0, score=score) for s, score in enumerate((0.1, 0.2, 0.9))]
    assert find(scores(sequence(truth, results, 3)), "mota", "car").counts["score"] == pytest.approx(0.4)


def test_durations_count_samples_of_half_a_second() -> None:
    """Found in samples 2, 3 and 6 of 8: late by 2, longest gap 2, lost once in between."""
    truth = [car(s, 0, 0.0) for s in range(8)]
    results = [car(2, 1, 0.0), car(3, 1, 0.0), car(6, 2, 0.0)]
    rows = scores(sequence(truth, results, 8))
    assert values(rows, "tid", "lgd", "frag", "ids", "mt", "ml") == [1.0, 1.0, 1, 1, 0, 0]


def test_false_alarms_are_per_hundred_samples_with_boxes_of_the_class() -> None:
    truth = [car(0, 0, 0.0), car(1, 0, 0.0), row(5, "bus", 1, 0.0)]
    results = [car(0, 1, 0.0), car(1, 1, 0.0), car(1, 2, 9.0), car(3, 3, 9.0)]
    assert values(scores(sequence(truth, results, 9)), "faf", "fp") == [pytest.approx(200 / 3), 2]


def test_mostly_tracked_is_from_four_fifths_on() -> None:
    truth = [car(s, own, 10.0 * own) for s in range(5) for own in range(2)]
    results = [car(s, 10, 0.0) for s in range(4)] + [car(0, 11, 10.0)]
    assert values(scores(sequence(truth, results, 5)), "mt", "ml") == [1, 0]  # 4 of 5; 1 of 5 isn't below a fifth


def test_over_classes_counts_are_summed_but_gt_is_averaged() -> None:
    truth = [car(s, 0, 0.0) for s in range(4)] + [row(0, "bus", 1, 20.0), row(1, "bus", 1, 20.0)]
    rows = scores(sequence(truth, truth, 4))
    assert values(rows, "tp", "gt", "amota", class_="all") == [6, 3.0, 1.0]
    assert find(rows, "gt").counts["gt"] == 6


def test_ids_of_two_sequences_are_different_tracks() -> None:
    one = sequence([car(0, 0, 0.0)], [car(0, 1, 0.0)], name="a")
    other = sequence([car(0, 0, 0.0)], [car(0, 2, 0.0)], name="b")
    assert values(scores(one, other), "tp", "ids", "mt") == [2, 0, 2]


@pytest.mark.parametrize("broken", [{"score": math.nan}, {"xyz": (math.nan, 0.0, 0.0)}, {"lwh": (4.0, -1.0, 1.0)}])
def test_invalid_results_are_false_positives(broken: Row) -> None:
    truth = [car(s, 0, 0.0) for s in range(3)]
    results = [car(s, 1, 0.0) for s in range(3)] + [{**car(1, 2, 0.0), **broken}]
    rows = scores(sequence(truth, results, 3))
    assert values(rows, "tp", "fp") == [3, 1]
    assert find(rows, "amota").counts["invalid"] == 1


def test_refused() -> None:
    with pytest.raises(MetricError, match="scene, sample 0: results has id 7 twice") as caught:
        PROFILE.measure(sequence([], [car(0, 7, 0.0), car(0, 7, 9.0)]))
    assert caught.value.code == "GT003"
    with pytest.raises(MetricError, match="sample 0: a result without track id"):
        PROFILE.measure(sequence([], [car(0, -1, 0.0)]))
    with pytest.raises(ConfigError, match="nuscenes-tracking matches by center distance only"):
        PROFILE.with_match(Match("ioubev", 0.5))
    assert PROFILE.with_match(Match("bev", 1.0)).settings.distance_m == 1.0


def test_without_any_truth() -> None:
    rows = scores(sequence([], [car(0, 1, 0.0)]))
    assert all(one.value is None for one in rows)
    assert find(rows, "amota").reason == "no truth boxes (nuscenes-devkit prints nan)"
    assert find(rows, "tp").reason == "no truth boxes (nuscenes-devkit prints 0)"
    assert all(one.value is None for one in scores(sequence([], [])))


def test_order_and_ids_of_boxes_change_nothing() -> None:
    rng = np.random.Generator(np.random.Philox(5))
    for scene in scenes_of(TRACKING_PLANS["crowded"]):
        wanted = scores(of_scene(scene))
        for rows in (scene.truth, scene.results):
            ids = rng.permutation(1_000_000)
            rows[:] = [{**rows[i], "id": int(ids[rows[i]["id"]])} for i in rng.permutation(len(rows))]
        assert scores(of_scene(scene)) == wanted


def test_order_of_boxes_and_ids_dont_decide_between_tracks_that_begin_in_one_place() -> None:
    """Both results begin on the truth; the one that goes on with it is followed only if it comes first."""
    truth = [car(s, 1, 2.5 * s) for s in range(3)]
    seen = []
    for stays, goes in ((1, 2), (2, 1)):
        results = [car(s, stays, 0.0) for s in range(3)] + [car(s, goes, 2.5 * s) for s in range(3)]
        seen += [scores(sequence(truth, rows, 3)) for rows in (results, results[::-1])]
    assert seen == [seen[0]] * 4


def test_statistics_add_in_any_grouping() -> None:
    parts = [PROFILE.measure(of_scene(scene)) for scene in scenes_of(TRACKING_PLANS["coarse"])]

    def total(order: tuple[int, ...]) -> TrackingStatistics:
        a, b, c, d = (parts[i] for i in order)
        return a + (b + (c + d)) if order[0] % 2 else (a + b) + (c + d)

    wanted = PROFILE.scores(total((0, 1, 2, 3)), "all")
    for order in itertools.permutations(range(4)):
        assert PROFILE.scores(total(order), "all") == wanted


def test_a_false_positive_never_raises_mota() -> None:
    scene = scenes_of(TRACKING_PLANS["few"])[0]
    before = find(scores(of_scene(scene)), "mota", "car").value
    scene.results.append(row(0, "car", 999_999, 0.0, xyz=(scene.ego[0][0] + 30, scene.ego[0][1], 0.0), score=0.99))
    after = find(scores(of_scene(scene)), "mota", "car").value
    assert before is not None
    assert after is not None
    assert after <= before
