"""Detection on nuScenes, by hand."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from tests.metrics.profiles.nuscenes.nuscenes_sequences import find, of_scene, row, sequence
from tests.metrics.profiles.nuscenes.oracles.nuscenes_scenes import DETECTION_PLANS, RACK, Row, scenes_of

from fbench.metrics.profiles.nuscenes.detection import NuscenesDetection
from fbench.metrics.profiles.nuscenes.ranking import (
    DetectionStatistics,
    average_precision,
    cumulative_mean,
    precision_curve,
)
from fbench.replay.contracts.errors import ConfigError, MetricError
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Objects

PROFILE = NuscenesDetection()


def scores(truth: list[Row], results: list[Row], num_steps: int = 1) -> list[Score]:
    return PROFILE.scores(PROFILE.measure(sequence(truth, results, num_steps)), "all")


def value(rows: list[Score], metric: str, class_: str = "car", matching: str | None = None) -> float:
    found = find(rows, metric, class_, matching).value
    assert found is not None
    return found


def test_identity_is_perfect_but_for_absent_classes() -> None:
    truth = [row(0, "car", i, 5.0 * i, attribute="vehicle.parked") for i in range(5)]
    rows = scores(truth, truth)
    assert value(rows, "ap", matching="bev 0.5 m") == pytest.approx(1.0)
    assert value(rows, "mean_dist_ap") == pytest.approx(1.0)
    assert [value(rows, e) for e in ("ate", "ase", "aoe", "ave", "aae")] == [0, 0, 0, 0, 0]
    assert value(rows, "map", "all") == pytest.approx(0.1)  # the other nine classes count 0
    assert find(rows, "ap", "bus", "bev 1 m").reason == "no truth boxes (nuscenes-devkit prints 0)"
    assert find(rows, "ate", "bus").reason == "no truth boxes (nuscenes-devkit prints 1)"


def test_precision_is_read_at_101_recalls_above_a_tenth_and_less_a_tenth() -> None:
    """Two of four found, a false positive between them: precision 1 to recall 0.25, then down to 2/3 at 0.5."""
    truth = [row(0, "car", i, 10.0 * i) for i in range(4)]
    results = [row(0, "car", 0, 0.0, score=0.9), row(0, "car", 1, 5.0, score=0.8), row(0, "car", 2, 10.0, score=0.7)]
    recalls = np.arange(11, 101) / 100
    # Recall stays at 0.25 with precision 1/2 for the false positive, and the line to (0.5, 2/3) starts from there.
    line = np.where(recalls < 0.25, 1.0, np.where(recalls <= 0.5, 0.5 + (recalls - 0.25) / 0.25 * (2 / 3 - 0.5), 0.0))
    expected = np.maximum(line - 0.1, 0).mean() / 0.9
    assert value(scores(truth, results), "ap", matching="bev 2 m") == pytest.approx(expected, abs=1e-12)


def test_a_recall_of_a_tenth_is_not_enough_for_errors() -> None:
    truth = [row(0, "car", i, 4.0 * i - 20) for i in range(10)]
    rows = scores(truth, [row(0, "car", 0, -20.5, score=0.9)])
    assert value(rows, "ate") == 1.0
    rows = scores(truth, [row(0, "car", i, 4.0 * i - 20.5, score=0.9) for i in range(2)])
    assert value(rows, "ate") == pytest.approx(0.5)


def test_errors_are_means_over_the_matches_so_far() -> None:
    """Off by 0 and then by 1: the mean so far is 0, then 0.5; between their scores it is a line."""
    truth = [row(0, "car", 0, 0.0), row(0, "car", 1, 20.0)]
    results = [row(0, "car", 0, 0.0, score=0.9), row(0, "car", 1, 21.0, score=0.5)]
    recalls = np.arange(11, 101) / 100
    expected = np.where(recalls <= 0.5, 0.0, (recalls - 0.5) / 0.5 * 0.5).mean()
    assert value(scores(truth, results), "ate") == pytest.approx(expected, abs=1e-12)


def test_each_error_by_hand() -> None:
    truth = [row(0, "car", 0, 0.0, velocity=(3.0, 0.0), attribute="vehicle.moving")]
    result = row(0, "car", 0, 0.6, 0.8, lwh=(2.0, 2.0, 1.5), yaw=-3.0, velocity=(0.0, 4.0), attribute="vehicle.parked")
    rows = scores(truth, [result])
    assert value(rows, "ate") == pytest.approx(1.0)
    assert value(rows, "ase") == pytest.approx(0.5)
    assert value(rows, "aoe") == pytest.approx(3.0)
    assert value(rows, "ave") == pytest.approx(5.0)
    assert value(rows, "aae") == 1.0
    assert value(rows, "ap", matching="bev 1 m") == pytest.approx(0.0)  # at the limit is too far
    assert value(rows, "ap", matching="bev 2 m") == pytest.approx(1.0)


def test_barriers_turn_by_half_and_cones_have_no_heading() -> None:
    truth = [row(0, "barrier", 0, 0.0), row(0, "traffic_cone", 1, 9.0)]
    rows = scores(truth, [{**one, "yaw": 3.0} for one in truth])
    assert value(rows, "aoe", "barrier") == pytest.approx(math.pi - 3.0)
    for name, metrics in (("barrier", ("ave", "aae")), ("traffic_cone", ("aoe", "ave", "aae"))):
        for metric in metrics:
            assert find(rows, metric, name).reason == f"not defined for {name} (nuscenes-devkit prints nan)"


def test_unknown_velocity_and_attribute_are_left_out_of_their_errors() -> None:
    nan = (math.nan, math.nan)
    truth = [row(0, "car", 0, 0.0, velocity=nan), row(0, "car", 1, 9.0, attribute="vehicle.parked")]
    results = [row(0, "car", 0, 0.0, score=0.9), row(0, "car", 1, 9.0, attribute="vehicle.parked", score=0.8)]
    rows = scores(truth, results)
    assert (value(rows, "ave"), value(rows, "aae")) == (0.0, 0.0)
    rows = scores(truth[:1], results[:1])
    assert (value(rows, "ave"), value(rows, "aae")) == (1.0, 1.0)  # known of no match


def test_scores_of_zero_reach_no_recall_for_errors() -> None:
    """The devkit takes a score of 0 for a recall that isn't reached."""
    truth = [row(0, "car", 0, 0.0)]
    rows = scores(truth, [row(0, "car", 0, 0.2, score=0.0)])
    assert (value(rows, "ap", matching="bev 1 m"), value(rows, "ate")) == (pytest.approx(1.0), 1.0)


def test_nds_is_half_map_and_half_errors() -> None:
    truth = [row(0, "car", 0, 0.0, attribute="vehicle.parked")]
    rows = scores(truth, [row(0, "car", 0, 0.3, attribute="vehicle.parked")])
    # 9 classes are absent: their errors are 1 each, where they have any.
    errors = [(9 + 0.3) / 10, 9 / 10, 8 / 9, 7 / 8, 7 / 8]
    assert [value(rows, f"m{e}", "all") for e in ("ate", "ase", "aoe", "ave", "aae")] == pytest.approx(errors)
    assert value(rows, "nds", "all") == pytest.approx((5 * 0.1 + sum(1 - e for e in errors)) / 10)


def test_what_does_not_count_is_counted() -> None:
    truth = [
        row(0, "car", 0, 49.9, points=1), row(0, "car", 1, 50.0, points=1), row(0, "car", 2, 0.0, points=0),
        row(0, "pedestrian", 3, 40.0), row(0, "bicycle", 4, 10.0), row(0, "car", 5, 10.0),
        row(0, "animal", 6, 5.0), row(0, RACK, 7, 10.0, points=0), row(0, "car", 8, 20.0, lwh=(4.0, -2.0, 1.5)),
    ]  # fmt: skip
    results = [row(0, "bicycle", 0, 11.9), row(0, "bicycle", 1, 12.1), row(0, "car", 2, 70.0), row(0, "tram", 3, 0.0)]
    counts = find(scores(truth, results), "map").counts
    wanted = {
        "gt": 2, "estimates": 1, "out_of_range_truth": 2, "out_of_range": 1, "no_points_truth": 1, "in_rack_truth": 1,
        "in_rack": 1, "unknown_class_truth": 1, "unknown_class": 1, "invalid_truth": 1, "invalid": 0,
    }  # fmt: skip
    assert {name: counts[name] for name in wanted} == wanted


def test_region_of_interest_leaves_out_both_sides() -> None:
    one = sequence([row(0, "car", 0, 0.0), row(0, "car", 1, 9.0)], [row(0, "car", 0, 0.0), row(0, "car", 1, 9.0)])
    truth = replace(one.truth, ignore=np.array([True, False]))
    results = replace(one.estimates, inside=np.array([False, True]))
    rows = PROFILE.scores(PROFILE.measure(replace(one, truth=truth, estimates=results)), "all")
    counts = find(rows, "map").counts
    assert [counts[name] for name in ("gt", "estimates", "ignored", "ignored_truth")] == [1, 1, 1, 1]


def test_range_is_measured_from_the_ego() -> None:
    far = sequence([row(0, "car", 0, 1000.0)], [row(0, "car", 0, 1000.0)])
    near = replace(far, ego_m=np.array([[990.0, 0.0, 0.0]]))
    assert [PROFILE.measure(one).parts[0].num_truth[0] for one in (far, near)] == [0, 1]


def test_racks_hold_by_their_own_axes_and_height() -> None:
    rack = row(0, RACK, 9, 0.0, lwh=(10.0, 1.0, 2.0), yaw=math.pi / 2)
    results = [
        row(0, "motorcycle", 0, 0.0, 4.0),
        row(0, "motorcycle", 1, 4.0),
        row(0, "bicycle", 2, 0.0, xyz=(0, 0, 2)),
    ]
    assert find(scores([rack], results), "map").counts["in_rack"] == 1


BROKEN: list[Row] = [
    {"score": math.nan}, {"score": math.inf}, {"xyz": (math.nan, 0.0, 0.0)}, {"xyz": (1e200, 0.0, 0.0)},
    {"lwh": (4.0, 0.0, 1.0)}, {"yaw": math.inf}, {"velocity": (math.inf, 0.0)},
]  # fmt: skip


@pytest.mark.parametrize("broken", BROKEN)
def test_invalid_results_are_false_positives(broken: Row) -> None:
    truth = [row(0, "car", 0, 0.0)]
    rows = scores(truth, [row(0, "car", 0, 0.0, score=0.4), {**row(0, "car", 1, 0.0, score=0.9), **broken}])
    one = find(rows, "ap", "car", "bev 2 m")
    assert (one.counts["tp"], one.counts["fp"]) == (1, 1)
    recalls = np.arange(11, 101) / 100  # it ranks first, so precision is a line from 0 to 1/2
    assert one.value == pytest.approx(np.maximum(recalls / 2 - 0.1, 0).mean() / 0.9)
    assert find(rows, "map").counts["invalid"] == 1


def test_only_scores_that_are_not_numbers() -> None:
    assert (
        value(scores([row(0, "car", 0, 0.0)], [row(0, "car", 0, 0.0, score=math.nan)]), "ap", matching="bev 2 m") == 0
    )


def test_refused() -> None:
    with pytest.raises(MetricError, match="scene, sample 1: truth has id 7 twice") as caught:
        PROFILE.measure(sequence([row(1, "car", 7, 0.0), row(1, "bus", 7, 9.0)], [], 2))
    assert caught.value.code == "GT003"
    with pytest.raises(MetricError, match="sample 0: 501 results, nuScenes allows 500"):
        PROFILE.measure(sequence([], [row(0, "car", i, 0.0) for i in range(501)]))
    flat = Objects(np.zeros(1, np.int64), np.array(["car"]), np.zeros(1, np.int64), np.zeros(1))
    with pytest.raises(MetricError, match="results without boxes in space"):
        PROFILE.measure(replace(sequence([], []), estimates=flat))


def test_results_in_a_sample_of_which_nobody_knows_where_the_ego_is_are_refused() -> None:
    # as where truth tells it box by box, and a sample has no truth
    there = sequence([row(0, "car", 0, 500.0)], [row(1, "car", 0, 900.0)], 2)
    somewhere = replace(there, ego_m=np.array([[500.0, 0, 0], [np.nan, np.nan, np.nan]]))
    with pytest.raises(MetricError, match="scene, sample 1: nobody tells where the ego is, so not how far off results"):
        PROFILE.measure(somewhere)
    assert find(PROFILE.scores(PROFILE.measure(replace(somewhere, estimates=there.truth)), "all"), "map").value


def test_match() -> None:
    one = PROFILE.with_match(Match("bev", 1.0))
    assert (one.settings.distances_m, one.settings.error_distance_m) == ((1.0,), 1.0)
    with pytest.raises(ConfigError, match="nuscenes-detection matches by center distance only"):
        PROFILE.with_match(Match("iou3d", 0.5))


def test_without_any_truth_or_result() -> None:
    rows = scores([], [])
    assert find(rows, "map").reason == "no truth boxes (nuscenes-devkit prints 0)"
    assert all(one.value is None for one in rows)
    found = scores([row(0, "car", 0, 0.0)], [])
    assert (value(found, "map", "all"), value(found, "ap", matching="bev 4 m"), value(found, "ate")) == (0, 0, 1)


def test_of_equal_scores_the_content_decides() -> None:
    truth = [row(0, "car", 0, 0.0)]
    results = [row(0, "car", 0, 1.5), row(0, "car", 1, 0.2)]
    for given in itertools.permutations(results):
        one = find(scores(truth, list(given)), "ap", "car", "bev 0.5 m")
        # x 0.2 goes before x 1.5, which counts at recall 1 alone.
        assert one.value == pytest.approx(1 - 0.5 / 90 / 0.9)
    statistics = [PROFILE.measure(sequence(truth, results, name=name)) for name in ("b", "a")]
    assert PROFILE.scores(statistics[0] + statistics[1], "") == PROFILE.scores(statistics[1] + statistics[0], "")


def test_order_and_ids_of_boxes_change_nothing() -> None:
    rng = np.random.Generator(np.random.Philox(5))
    for scene in scenes_of(DETECTION_PLANS["coarse"])[:2]:
        wanted = PROFILE.scores(PROFILE.measure(of_scene(scene)), "all")
        for rows in (scene.truth, scene.results):
            ids = rng.permutation(10_000)
            rows[:] = [{**rows[i], "id": int(ids[i])} for i in rng.permutation(len(rows))]
        assert PROFILE.scores(PROFILE.measure(of_scene(scene)), "all") == wanted


def test_statistics_add_in_any_grouping() -> None:
    parts = [PROFILE.measure(of_scene(scene)) for scene in scenes_of(DETECTION_PLANS["coarse"])]

    def total(order: tuple[int, ...]) -> DetectionStatistics:
        a, b, c, d = (parts[i] for i in order)
        return a + (b + (c + d)) if order[0] % 2 else (a + b) + (c + d)

    wanted = PROFILE.scores(total((0, 1, 2, 3)), "all")
    assert all(PROFILE.scores(total(order), "all") == wanted for order in itertools.permutations(range(4)))


def test_a_false_positive_never_raises_ap() -> None:
    scene = scenes_of(DETECTION_PLANS["plain"])[0]
    before = PROFILE.scores(PROFILE.measure(of_scene(scene)), "all")
    ego = scene.ego[0]
    scene.results.append(row(0, "car", 99_999, 0.0, xyz=(ego[0] + 30, ego[1] + 30, 0.0), score=0.45))
    after = PROFILE.scores(PROFILE.measure(of_scene(scene)), "all")
    assert value(after, "map", "all") <= value(before, "map", "all")


def test_helpers_of_curves() -> None:
    assert cumulative_mean(np.array([math.nan, 2.0, math.nan, 4.0])).tolist() == [0.0, 2.0, 2.0, 3.0]
    assert cumulative_mean(np.array([math.nan])).tolist() == [1.0]
    curve = precision_curve(np.array([0.9]), np.array([True]), 2)
    assert np.flatnonzero(curve.confidence).tolist() == list(range(51))  # up to the recall achieved
    assert average_precision(np.full(101, 0.05), 0.1, 0.1) == 0.0
