"""The rules of `kitti-3dmot` on scenes small enough to count by hand, and what must not change its numbers."""

from dataclasses import replace
from functools import reduce
from operator import add

import numpy as np
import pytest
from tests.metrics.profiles.kitti.kitti_rows import tracking_objects, tracking_sequence
from tests.metrics.profiles.kitti.oracles.kitti_tracks_input import SEQUENCES, made_sequence

from fbench.metrics.profiles.kitti.rows import recall_thresholds
from fbench.metrics.profiles.kitti.tracking import Kitti3dMot
from fbench.replay.contracts.errors import ConfigError, MetricError
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.sequences import Objects, Sequence

PROFILE = Kitti3dMot()


def row(
    frame: int,
    track: int,
    x: float,
    kind: str = "Car",
    score: float | None = None,
    top: float = 100,
    levels: str = "0 0",
    height: float = 1.5,
) -> str:
    """A car-sized box 20 m ahead, `x` m to the right; its rectangle is 100 px high unless `top` says otherwise."""
    left = 600 + 40 * x
    numbers = f"{left} {top} {left + 60} 200 {height} 1.6 4.0 {x} 1.6 20 0"
    return f"{frame} {track} {kind} {levels} 0 {numbers}" + ("" if score is None else f" {score}")


def region(frame: int, left: float) -> str:
    return f"{frame} -1 DontCare -1 -1 -10 {left} 0 {left + 100} 300 -1 -1 -1 -1000 -1000 -1000 -10"


def values(truth, results, profile=PROFILE, label="car", num_frames=None) -> dict[str, float | None]:
    lines = [*truth, *results]
    frames = num_frames or 1 + max((int(line.split()[0]) for line in lines), default=0)
    sequence = tracking_sequence("0000", truth, results, frames)
    return {r.metric: r.value for r in profile.scores(profile.measure(sequence), "all") if r.class_ == label}


def rows_of(sequences, profile=PROFILE):
    return profile.scores(reduce(add, map(profile.measure, sequences)), "all")


@pytest.fixture(scope="module")
def made():
    return [
        tracking_sequence(name, *made_sequence(seed, length, 9.0), length)
        for seed, (name, length) in enumerate(SEQUENCES.items())
    ]


def test_truth_as_result_is_perfect():
    truth = [row(f, t, 8 * t) for t in range(3) for f in range(10)]
    own = values(truth, [row(f, t, 8 * t, score=t) for t in range(3) for f in range(10)])
    assert own["mota"] == own["motal"] == own["recall"] == own["precision"] == own["f1"] == own["mt"] == 1
    assert own["motp"] == pytest.approx(1, abs=1e-12)
    assert own["ids"] == own["frag"] == own["fp"] == own["fn"] == 0


def test_recalls_are_fortieths_and_smota_is_clipped_to_one():
    # 40 truth boxes, 20 found, each with a score of its own: thresholds of recalls 1/40 to 19/40 remain, the first is
    # dropped. With k + 1 hits at recall k/40, sMOTA is 1 + 1/k, clipped to 1; MOTA is (k + 1)/40.
    truth = [row(f, f, 0) for f in range(40)]
    own = values(truth, [row(f, f, 0, score=100 - f) for f in range(20)])
    assert own["samota"] == pytest.approx(19 / 40, abs=1e-12)
    assert own["amota"] == pytest.approx(sum((k + 1) / 40 for k in range(1, 20)) / 40, abs=1e-12)
    assert own["amotp"] == pytest.approx(19 / 40, abs=1e-12)
    assert own["mota"] == 0.5


def test_thresholds_are_those_nearest_to_each_recall():
    scores = np.array([0.9, 0.8, 0.7, 0.6, 0.5])
    thresholds, recalls = recall_thresholds(scores, 10, 5)
    # recall 0: first hit; 0.2: second; 0.4: fourth; 0.6 isn't reached, the last hit stands for it
    assert thresholds == (0.9, 0.8, 0.6, 0.5)
    assert recalls == pytest.approx((0, 0.2, 0.4, 0.6))


def test_mota_is_not_clipped_and_falls_below_zero():
    own = values([row(0, 1, 0)], [row(0, i, 10 * i, score=1) for i in range(1, 5)])
    assert own["mota"] == 1 - (1 + 4) / 1
    assert own["samota"] == 0


def test_best_threshold_maximises_mota():
    truth = [row(f, t, 8 * t) for t in range(4) for f in range(10)]
    results = [row(f, t, 8 * t, score=10 - t) for t in range(4) for f in range(10)]
    results += [row(f, 50 + i, -6.0 * (i + 1), score=1) for i in range(5) for f in range(10)]
    own = values(truth, results)
    assert own["best_threshold"] == 7
    assert own["mota"] == 1
    assert own["fp"] == 0


def test_neighboring_classes_are_neutral():
    truth = [row(0, 1, 0), row(0, 2, 10, "Van"), row(0, 3, 20, "Van")]
    results = [row(0, 1, 0, score=1), row(0, 2, 10, score=1), row(0, 9, -10, "Van", score=1)]
    own = values(truth, results)
    assert (own["tp"], own["itp"], own["fp"], own["fn"], own["ifn"]) == (2, 1, 0, 0, 1)
    assert own["mota"] == 1
    assert (own["gt_objects"], own["ignored_gt_objects"], own["ignored_tracker_objects"]) == (3, 2, 1)


def test_only_people_who_sit_are_neighbors_of_pedestrians():
    # the tracking labels say `Person`, which AB3DMOT doesn't read; `Person_sitting` it does
    for kind, false_alarms in (("Person", 1), ("Person_sitting", 0)):
        truth = [row(0, 1, 0, "Pedestrian"), row(0, 2, 10, kind)]
        results = [row(0, 1, 0, "Pedestrian", score=1), row(0, 2, 10, "Pedestrian", score=1)]
        assert values(truth, results, label="pedestrian")["fp"] == false_alarms


def test_low_results_and_those_in_regions_are_excused_only_where_they_match_nothing():
    truth = [row(0, 1, 0), row(0, 2, 5, levels="0 3"), row(0, 3, 12, levels="1 0"), region(0, 580), region(0, 380)]
    results = [
        row(0, 1, 0, score=1),  # in a region, but a hit
        row(0, 7, -5, score=1),  # in a region
        row(0, 8, 18, score=1, top=175),  # 25 px high
        row(0, 9, 25, score=1, top=174.9),
    ]
    own = values(truth, results)
    assert (own["tp"], own["fp"], own["fn"], own["ifn"]) == (1, 1, 0, 2)
    assert own["ignored_tracker_objects"] == 2


def test_switches_and_fragments_follow_ab3dmots_walk():
    # ids by frame: 1 1 2 2 - 2 3. Switches at 2 and 6. Fragments where an id differs from the frame before (also none)
    # and the next frame is matched: at 2 and 5; the last frame needs no next: at 6.
    truth = [row(f, 1, 0) for f in range(7)]
    ids = {0: 1, 1: 1, 2: 2, 3: 2, 5: 2, 6: 3}
    own = values(truth, [row(f, t, 0, score=1) for f, t in ids.items()])
    assert own["ids"] == 2
    assert own["frag"] == 3
    assert own["mt"] == 1  # 6 of 7


def test_an_ignored_first_frame_counts_as_tracked():
    # 5 frames, the first ignored and matched, 3 of the other 4 matched: AB3DMOT says 4 of 4, mostly tracked
    truth = [row(f, 1, 0, levels="0 3" if f == 0 else "0 0") for f in range(5)]
    own = values(truth, [row(f, 1, 0, score=1) for f in range(4)])
    assert (own["mt"], own["pt"], own["itp"], own["fn"]) == (1, 0, 1, 1)


def test_without_truth_of_a_class_there_is_no_mota_but_a_reason():
    sequence = tracking_sequence("0000", [row(0, 1, 0)], [row(0, 1, 0, "Cyclist", score=1)], 1)
    rows = {r.metric: r for r in PROFILE.scores(PROFILE.measure(sequence), "all") if r.class_ == "cyclist"}
    assert rows["mota"].value is None
    assert rows["mota"].reason == "no truth boxes that count (AB3DMOT prints -inf)"
    for name in ("samota", "amota", "amotp"):
        assert rows[name].value is None
        assert rows[name].reason == "no truth boxes that count (AB3DMOT prints 0, then stops)"
    assert rows["recall"].reason == "no truth boxes (AB3DMOT prints 0)"
    assert rows["fp"].value == 1


def test_truth_that_is_all_ignored_gives_an_amotp_but_no_amota():
    # two ignored boxes, each matched at a score of its own: the recalls' thresholds are those of ignored matches too
    truth = [row(0, 1, 0, levels="0 3"), row(0, 2, 10, levels="0 3")]
    sequence = tracking_sequence("0000", truth, [row(0, 1, 0, score=2), row(0, 2, 10, score=1)], 1)
    rows = {r.metric: r for r in PROFILE.scores(PROFILE.measure(sequence), "all") if r.class_ == "car"}
    assert rows["amotp"].value == pytest.approx(1 / 40, abs=1e-12)
    for name in ("samota", "amota", "mota"):
        assert rows[name].value is None
        assert rows[name].reason == "no truth boxes that count (AB3DMOT prints -inf)"


def test_a_region_of_unknown_place_excuses_nothing():
    truth, results = [row(0, 1, 0), region(0, 1000)], [row(0, 1, 0, score=1), row(0, 2, 5, score=1)]
    sequence = tracking_sequence("0000", truth, results, 1)
    nowhere = np.array(sequence.truth.xyxy_px)
    nowhere[sequence.truth.label == "dontcare"] = np.nan
    for xyxy_px in (nowhere, None):
        blind = replace(sequence, truth=replace(sequence.truth, xyxy_px=xyxy_px))
        own = {r.metric: r.value for r in PROFILE.scores(PROFILE.measure(blind), "all") if r.class_ == "car"}
        assert (own["fp"], own["ignored_tracker_objects"]) == (1, 0)


def test_all_results_are_at_no_threshold():
    rows = PROFILE.scores(
        PROFILE.measure(tracking_sequence("0000", [row(0, 1, 0)], [row(0, 5, 30, score=1)], 1)), "all"
    )
    told = next(r for r in rows if (r.class_, r.metric) == ("car", "best_threshold"))
    assert (told.value, told.reason) == (
        None, "no threshold has a MOTA above 0, so all results count (AB3DMOT takes -10000)"
    )  # fmt: skip


def test_without_results_everything_is_missed():
    own = values([row(0, 1, 0), row(1, 1, 0)], [])
    assert (own["mota"], own["samota"], own["amota"], own["fn"], own["ml"]) == (0, 0, 0, 2, 1)
    assert own["precision"] is None
    assert own["motp"] is None
    assert own["best_threshold"] is None


def test_an_empty_sequence_is_all_null_but_counts():
    own = values([], [], num_frames=1)
    assert {name for name, value in own.items() if value} == {"modp"}
    assert own["modp"] == 1  # AB3DMOT gives a frame without matches 1


def test_results_that_are_no_boxes_are_false_positives_at_every_threshold():
    good = tracking_sequence("0", [row(0, 1, 0), row(1, 1, 0)], [row(f, 1, 0, score=f) for f in range(2)], 2)
    bad = np.array([[np.nan, 0, 0], [1, 1, 1], [1, 1, 1]])
    size = np.array([[1, 1, 1], [-1, 1, 1], [1, 1, 1.0]])
    score = np.array([0, 0, np.inf])
    wrong = Objects(
        np.zeros(3, np.int64), np.full(3, "car"), np.arange(5, 8), score, np.zeros((3, 4)), bad, size, np.zeros(3)
    )
    sequence = replace(good, estimates=joined(wrong, good.estimates))
    rows = {r.metric: r for r in rows_of([sequence]) if r.class_ == "car"}
    assert rows["fp"].value == 3
    assert rows["mota"].value == 1 - 3 / 2
    assert rows["mota"].counts["invalid_results"] == 3


def joined(a: Objects, b: Objects) -> Objects:
    names = ("step", "label", "track_id", "score", "xyxy_px", "center_m", "size_lwh_m", "yaw_rad")
    both = {name: np.concatenate([getattr(a, name), getattr(b, name)]) for name in names}
    order = np.argsort(both["step"], kind="stable")
    return Objects(**{name: values[order] for name, values in both.items()})


def test_truth_without_a_size_is_left_out_and_counted():
    truth = [row(0, 1, 0), row(0, 2, 10, height=-1), row(0, 3, 20, height=0)]
    sequence = replace(tracking_sequence("0", truth, [row(0, 1, 0, score=1)], 1), num_invalid_truth=2)
    rows = {r.metric: r for r in rows_of([sequence]) if r.class_ == "car"}
    assert rows["mota"].value == 1
    assert rows["mota"].counts["invalid_truth"] == 4


@pytest.mark.parametrize("side", ["truth", "results"])
def test_an_id_twice_in_a_frame_is_fatal(side):
    once = [row(0, 1, 0), row(3, 4, 0)]
    twice = [*once, row(3, 4, 9)]
    truth, results = (twice, once) if side == "truth" else (once, twice)
    with pytest.raises(MetricError, match=f"0007: frame 3: {side} has id 4 twice") as raised:
        PROFILE.measure(tracking_sequence("0007", truth, results, 4))
    assert raised.value.code == "GT003"


def test_other_matches_are_refused():
    with pytest.raises(ConfigError, match="expected iou3d or iou2d"):
        PROFILE.with_match(Match("bev", 2))
    assert PROFILE.with_match(Match("iou2d", 0.5)).rules.match == Match("iou2d", 0.5)


def test_results_without_solids_cannot_be_matched_in_space():
    sequence = tracking_sequence("0", [row(0, 1, 0)], [row(0, 1, 0, score=1)], 1)
    flat = replace(sequence.estimates, center_m=None, size_lwh_m=None, yaw_rad=None)
    with pytest.raises(MetricError, match="no 3D boxes"):
        PROFILE.measure(replace(sequence, estimates=flat))
    assert rows_of([replace(sequence, estimates=flat)], PROFILE.with_match(Match("iou2d", 0.5)))


def test_a_region_of_interest_ignores_both_sides():
    truth, results = [row(0, 1, 0), row(0, 2, 10)], [row(0, 1, 0, score=1), row(0, 9, 20, score=1)]
    sequence = tracking_sequence("0", truth, results, 1)
    inside = np.array([True, False])
    sides = (replace(objects, inside=inside) for objects in (sequence.truth, sequence.estimates))
    rows = {r.metric: r.value for r in rows_of([Sequence("0", sequence.steps, *sides)]) if r.class_ == "car"}
    assert (rows["mota"], rows["fp"], rows["fn"]) == (1, 0, 0)


def test_grouping_and_order_of_sequences_change_nothing(made):
    a, b, c = map(PROFILE.measure, made)
    wanted = PROFILE.scores(a + b + c, "all")
    assert PROFILE.scores(a + (b + c), "all") == wanted
    assert PROFILE.scores((c + a) + b, "all") == wanted


@pytest.mark.parametrize("match", [Match("iou3d", 0.25), Match("iou2d", 0.5)])
def test_order_of_rows_and_ids_change_nothing(made, match):
    rng = np.random.default_rng(1)
    profile = PROFILE.with_match(match)
    assert rows_of([shuffled(s, rng) for s in made], profile) == rows_of(made, profile)


@pytest.mark.parametrize("match", [Match("iou3d", 0.25), Match("iou2d", 0.5)])
def test_ids_dont_decide_between_tracks_that_share_a_box(match):
    # In frame 1 two results lie on the truth; only one of them was there before.
    profile, seen = PROFILE.with_match(match), []
    for old, new in ((1, 2), (2, 1)):
        results = [row(0, old, 0, score=1), row(1, old, 0, score=1), row(1, new, 0, score=1), row(2, old, 0, score=1)]
        seen += [values([row(f, 1, 0) for f in range(3)], lines, profile) for lines in (results, results[::-1])]
    assert seen[0]["ids"] == 0
    assert seen == [seen[0]] * 4


def shuffled(sequence: Sequence, rng: np.random.Generator) -> Sequence:
    """Other ids, and the rows of each frame in another order."""
    sides = []
    for objects in (sequence.truth, sequence.estimates):
        ids = {
            int(old): int(new) for old, new in zip(np.unique(objects.track_id), rng.permutation(10_000), strict=False)
        }
        renamed = np.array([i if i < 0 else ids[int(i)] for i in objects.track_id])
        rows = np.lexsort((rng.random(len(objects)), objects.step))
        sides.append(replace(objects, track_id=renamed)[rows])
    return replace(sequence, truth=sides[0], estimates=sides[1])


def test_a_false_positive_more_never_raises_mota(made):
    rng = np.random.default_rng(2)
    before = {r.class_: r.value for r in rows_of(made[2:]) if r.metric == "mota"}
    for i in range(10):
        kind = rng.choice(["Car", "Pedestrian", "Cyclist"])
        line = row(int(rng.integers(0, 30)), 77_000 + i, 200.0, kind, score=float(rng.normal(0, 5)))
        more = joined(tracking_objects([line]), made[2].estimates)
        after = {r.class_: r.value for r in rows_of([replace(made[2], estimates=more)]) if r.metric == "mota"}
        assert all(after[label] <= before[label] for label in before)
