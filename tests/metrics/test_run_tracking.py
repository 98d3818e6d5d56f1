"""CLEAR MOT of sequences whose counts can be told by hand."""

from collections.abc import Sequence
from dataclasses import replace
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.metrics.conftest import Case, MakeRun, boxes2d, boxes3d, front_camera

from fbench.metrics.core.bootstrap import Bootstrap
from fbench.metrics.runs.combine import combine_runs, measure_run
from fbench.metrics.runs.scoring import intervals_of_run
from fbench.metrics.runs.tracking import Tracking
from fbench.replay.contracts.errors import MetricError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.scores import Score, ScoreOptions
from fbench.replay.runs.folder import Run

OPTIONS = ScoreOptions()
CAR = boxes3d((10, 0), label="car", ids=[1])


def scores(run: Run, options: ScoreOptions = OPTIONS, class_: str = "vehicle", space: str = "bev") -> dict[str, Score]:
    rows = Tracking().scores(run, options)
    return {r.metric: r for r in rows if r.class_ == class_ and r.matching.startswith(space)}


def counts(run: Run, **where: Any) -> tuple[float, ...]:
    """(gt, fn, fp, idsw)."""
    c = scores(run, **where)["mota"].counts
    return c["gt"], c["fn"], c["fp"], c["idsw"]


CLEAR = ("mota", "mota_no_fp", "motp", "idsw")


def values(run: Run, names: Sequence[str] = CLEAR, **where: Any) -> dict[str, float | None]:
    rows = scores(run, **where)
    return {name: rows[name].value for name in names}


def reasons(run: Run) -> dict[str, str | None]:
    return {name: row.reason for name, row in scores(run).items()}


def track(number: int, x: float = 10, y: float = 0) -> Boxes3D:
    """One estimate."""
    return boxes3d((x, y), ids=[number])


def test_the_worked_example_of_standard_and_thesis_mota(make_run: MakeRun) -> None:
    """GT 100, FN 20, FP 60, IDSW 2: 0.18, and 0.78 without FP."""
    tracks = [7] * 30 + [8] * 30 + [9] * 20
    cases = [Case(boxes3d((10, 0), *[(30, 0)] * (i < 60), ids=[t, 100][: 1 + (i < 60)]), CAR)
             for i, t in enumerate(tracks)]  # fmt: skip
    run = make_run(*cases, *[Case(Boxes3D.empty(), CAR)] * 20)
    assert counts(run) == (100, 20, 60, 2)
    assert values(run) == {
        "mota": pytest.approx(0.18),
        "mota_no_fp": pytest.approx(0.78),
        "motp": 0.0,
        "idsw": 2.0,
    }


def test_a_perfect_track(make_run: MakeRun) -> None:
    assert values(make_run(*[Case(track(5), CAR)] * 3)) == {"mota": 1.0, "mota_no_fp": 1.0, "motp": 0.0, "idsw": 0.0}


def test_mota_isnt_clipped(make_run: MakeRun) -> None:
    run = make_run(Case(boxes3d((20, 0), (30, 0), (40, 0), ids=[1, 2, 3]), CAR))
    assert (values(run)["mota"], values(run)["mota_no_fp"]) == (-3.0, 0.0)


def test_a_switch(make_run: MakeRun) -> None:
    assert counts(make_run(Case(track(1), CAR), Case(track(2), CAR), Case(track(2), CAR))) == (3, 0, 0, 1)


def test_a_switch_across_a_gap_of_any_length(make_run: MakeRun) -> None:
    gap = [Case(Boxes3D.empty(), CAR)] * 5
    assert counts(make_run(Case(track(1), CAR), *gap, Case(track(2), CAR))) == (7, 5, 0, 1)


def test_a_fragment_without_switch(make_run: MakeRun) -> None:
    assert counts(make_run(Case(track(1), CAR), Case(Boxes3D.empty(), CAR), Case(track(1), CAR))) == (3, 1, 0, 0)


def test_switching_there_and_back_counts_twice(make_run: MakeRun) -> None:
    assert counts(make_run(Case(track(1), CAR), Case(track(2), CAR), Case(track(1), CAR))) == (3, 0, 0, 2)


def test_two_tracks_that_swap_are_two_switches(make_run: MakeRun) -> None:
    truth = boxes3d((10, 0), (20, 0), label="car", ids=[1, 2])
    first, second = boxes3d((10, 0), (20, 0), ids=[7, 8]), boxes3d((10, 0), (20, 0), ids=[8, 7])
    assert counts(make_run(Case(first, truth), Case(second, truth))) == (4, 0, 0, 2)


def test_the_previous_pair_stays_although_another_is_nearer(make_run: MakeRun) -> None:
    far_and_near = boxes3d((11.9, 0), (10, 0), ids=[1, 2])
    assert counts(make_run(Case(track(1), CAR), Case(far_and_near, CAR))) == (2, 0, 1, 0)


def test_the_previous_pair_goes_when_it_is_beyond_the_threshold(make_run: MakeRun) -> None:
    far_and_near = boxes3d((12.1, 0), (10, 0), ids=[1, 2])
    assert counts(make_run(Case(track(1), CAR), Case(far_and_near, CAR))) == (2, 0, 1, 1)


def test_after_a_gap_the_nearest_wins_over_the_old_pair(make_run: MakeRun) -> None:
    far_and_near = boxes3d((11.9, 0), (10, 0), ids=[1, 2])
    run = make_run(Case(track(1), CAR), Case(track(5, 30), CAR), Case(far_and_near, CAR))
    assert counts(run) == (3, 1, 2, 1)


def test_frames_without_any_track_are_no_gap(make_run: MakeRun) -> None:
    """As in TrackEval, which goes on from the last frame that had truth and tracks."""
    far_and_near = boxes3d((11.9, 0), (10, 0), ids=[1, 2])
    run = make_run(Case(track(1), CAR), Case(Boxes3D.empty(), CAR), Case(far_and_near, CAR))
    assert counts(run) == (3, 1, 1, 0)


def test_identities_end_with_their_segment(make_run: MakeRun) -> None:
    run = make_run(Case(track(1), CAR), Case(track(2), CAR, segment=1), Case(track(3), CAR, segment=1))
    assert counts(run) == (3, 0, 0, 1)


def test_frames_without_truth_arent_scored(make_run: MakeRun) -> None:
    run = make_run(Case(track(1), CAR), Case(track(9, 30)), Case(track(1), CAR))
    assert counts(run) == (2, 0, 0, 0)


def test_motp_is_the_mean_distance_or_overlap_of_matches(make_run: MakeRun) -> None:
    run = make_run(Case(track(1, 10.5), CAR), Case(track(1, 11), CAR))
    row = scores(run)["motp"]
    assert (row.value, row.unit) == (0.75, "m")
    box, half = (0, 0, 100, 100), (0, 0, 100, 60)
    run = make_run(Case(boxes2d(half, ids=[1]), truth2d=boxes2d(box, label="car", ids=[1])), rig=front_camera())
    row = scores(run, space="iou")["motp"]
    assert row.value == pytest.approx(0.6)
    assert row.unit == "iou"


def test_ignored_truth_costs_nothing(make_run: MakeRun) -> None:
    parked = boxes3d((10, 0), (20, 0), label="car", ids=[1, 2], ignore=[False, True])
    assert counts(make_run(Case(boxes3d((10, 0), (20, 0), ids=[1, 2]), parked))) == (1, 0, 0, 0)


def test_leaving_the_region_costs_nothing(make_run: MakeRun) -> None:
    xs = (47, 49, 50.5, 52)
    run = make_run(*[Case(track(1, x + 0.6), boxes3d((x, 0), label="car", ids=[1])) for x in xs])
    assert counts(run) == (2, 0, 0, 0)


def test_one_object_in_two_cameras_is_two_sequences(make_run: MakeRun) -> None:
    box = (0, 0, 100, 100)

    def both(left: int, right: int) -> Any:
        return boxes2d(box, box, camera=["l", "r"], ids=[left, right], label="car")

    run = make_run(
        Case(both(1, 2), truth2d=both(5, 5)), Case(both(1, 3), truth2d=both(5, 5)), rig=front_camera("l", "r")
    )
    assert counts(run, space="iou") == (4, 0, 0, 1)


def test_3d_tracks_are_scored_in_the_image_too(make_run: MakeRun) -> None:
    run = make_run(Case(track(1), CAR), Case(track(2), CAR), rig=front_camera())
    assert counts(run, space="iou 0.5, truth projected from 3D") == (2, 0, 0, 1)


def test_labels_have_rows_of_their_own(make_run: MakeRun) -> None:
    truth = boxes3d((10, 0), (20, 0), label=["car", "truck"], ids=[1, 2])
    run = make_run(Case(boxes3d((10, 0), (20, 0), label=["car", "car"], ids=[1, 2]), truth))
    assert counts(run) == (2, 0, 0, 0)
    assert counts(run, class_="car") == (1, 0, 1, 0)
    assert counts(run, class_="truck") == (1, 1, 0, 0)


class TestUndefined:
    def test_no_truth(self, make_run: MakeRun) -> None:
        assert set(reasons(make_run(Case(track(1)))).values()) == {"no truth"}

    def test_no_truth_boxes(self, make_run: MakeRun) -> None:
        run = make_run(Case(track(1), Boxes3D.empty()))
        assert set(reasons(run).values()) == {"no truth boxes"}
        assert counts(run) == (0, 0, 1, 0)

    @pytest.mark.parametrize("ids", [None, [-1]])
    def test_truth_without_ids_leaves_only_motp(self, make_run: MakeRun, ids: Sequence[float] | None) -> None:
        run = make_run(Case(track(1, 10.5), boxes3d((10, 0), label="car", ids=ids)))
        why = "truth has no track ids"
        assert {name: reason for name, reason in reasons(run).items() if reason != why} == {"motp": None}
        assert values(run)["motp"] == 0.5

    def test_tracks_without_ids(self, make_run: MakeRun) -> None:
        why = "tracks have no ids"
        found = reasons(make_run(Case(boxes3d((10, 0)), CAR)))
        assert {name: reason for name, reason in found.items() if reason != why} == {"motp": None}

    def test_no_tracks_at_all(self, make_run: MakeRun) -> None:
        run = make_run(Case(Boxes3D.empty(), CAR))
        assert values(run) == {"mota": 0.0, "mota_no_fp": 0.0, "motp": None, "idsw": 0.0}
        assert reasons(run)["motp"] == "no matches"

    def test_boxes_without_id_match_but_never_switch(self, make_run: MakeRun) -> None:
        truth = boxes3d((10, 0), (20, 0), label="car", ids=[1, -1])
        first, second = boxes3d((10, 0), (20, 0), ids=[1, 2]), boxes3d((10, 0), (20, 0), ids=[-1, 3])
        assert counts(make_run(Case(first, truth), Case(second, truth), Case(first, truth))) == (6, 0, 0, 0)


class TestDuplicateIds:
    def test_in_truth(self, make_run: MakeRun) -> None:
        run = make_run(Case(track(1), CAR), Case(track(1), boxes3d((10, 0), (20, 0), label="car", ids=[4, 4])))
        with pytest.raises(MetricError, match="frame 1: truth has id 4 twice"):
            scores(run)

    def test_in_tracks(self, make_run: MakeRun) -> None:
        run = make_run(Case(boxes3d((10, 0), (20, 0), ids=[6, 6]), CAR))
        with pytest.raises(MetricError, match=r"^'.+' on log '.+': frame 0: tracks has id 6 twice") as caught:
            scores(run)
        assert str(run.folder) not in str(caught.value)  # before a run is whole its folder has another name

    def test_in_one_image(self, make_run: MakeRun) -> None:
        twice = boxes2d((0, 0, 9, 9), (20, 0, 29, 9), ids=[1, 1], label="car")
        run = make_run(Case(boxes2d((0, 0, 9, 9), ids=[1]), truth2d=twice), rig=front_camera())
        with pytest.raises(MetricError, match="frame 0, camera front: truth has id 1 twice"):
            scores(run)


Sequences = list[list[tuple[float, float]]]
PLACE = st.tuples(st.floats(0, 12), st.floats(-2, 2))
SEQUENCES = st.lists(st.lists(PLACE, max_size=4), min_size=1, max_size=4)
RUNS = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def cases(truth: Sequences, tracks: Sequences, ids: dict[int, int]) -> list[Case]:
    frames = max(len(truth), len(tracks))
    truth, tracks = truth + [[]] * (frames - len(truth)), tracks + [[]] * (frames - len(tracks))
    return [
        Case(boxes3d(*e, ids=[ids[i] for i in range(len(e))]), boxes3d(*t, label="car", ids=range(len(t))))
        for t, e in zip(truth, tracks, strict=True)
    ]


def shuffled(case: Case, random: Random) -> Case:
    assert case.truth is not None
    rows = [np.array(random.sample(range(len(b)), len(b)), int) for b in (case.estimates, case.truth)]
    return Case(case.estimates[rows[0]], case.truth[rows[1]])


@pytest.mark.slow
@RUNS
@given(SEQUENCES, SEQUENCES, st.randoms(use_true_random=False))
def test_the_order_of_boxes_changes_nothing(
    make_run: MakeRun, truth: Sequences, tracks: Sequences, random: Random
) -> None:
    ordered = cases(truth, tracks, {i: i for i in range(4)})
    mixed = [shuffled(case, random) for case in ordered]
    assert Tracking().scores(make_run(*ordered), OPTIONS) == Tracking().scores(make_run(*mixed), OPTIONS)


@pytest.mark.slow
@RUNS
@given(SEQUENCES, SEQUENCES, st.permutations([3, 50, 7, 1000]))
def test_names_of_tracks_change_nothing(
    make_run: MakeRun, truth: Sequences, tracks: Sequences, names: list[int]
) -> None:
    # Boxes may coincide: then the lives of their tracks tell them apart.
    plain = make_run(*cases(truth, tracks, {i: i for i in range(4)}))
    renamed = make_run(*cases(truth, tracks, dict(enumerate(names))))
    assert Tracking().scores(plain, OPTIONS) == Tracking().scores(renamed, OPTIONS)


@RUNS
@given(SEQUENCES.filter(any))
def test_tracks_that_equal_truth_score_one(make_run: MakeRun, truth: Sequences) -> None:
    truth = [list(dict.fromkeys(frame)) for frame in truth]
    run = make_run(*cases(truth, truth, {i: i for i in range(4)}))
    found = scores(run)
    assert found["motp"].value is not None
    assert found["mota"].counts["fn"] == found["mota"].counts["fp"] == 0


@pytest.mark.slow
@RUNS
@given(SEQUENCES, SEQUENCES)
def test_mota_adds_up(make_run: MakeRun, truth: Sequences, tracks: Sequences) -> None:
    run = make_run(*cases(truth, tracks, {i: i for i in range(4)}))
    gt, fn, fp, idsw = counts(run)
    assert gt == sum(len(frame) for frame in truth)
    assert gt - fn + fp == sum(len(frame) for frame in tracks)
    if gt:
        assert values(run)["mota"] == pytest.approx(1 - (fn + fp + idsw) / gt)
        assert values(run)["mota_no_fp"] == pytest.approx(1 - (fn + idsw) / gt)


def test_a_pipeline_without_tracks_has_no_scores_of_them(make_run: MakeRun) -> None:
    cases = [Case(track(7), CAR, tracks=Boxes3D.empty())] * 3
    none = make_run(*cases, has_tracks=False)
    assert set(reasons(none).values()) == {"the pipeline gave no tracks"}
    assert set(values(none).values()) == {None}
    assert reasons(make_run(*cases))["mota"] is None
    assert values(make_run(*cases))["mota"] == 0.0


def test_a_run_without_tracks_counts_as_missed_beside_others(make_run: MakeRun) -> None:
    cases = [Case(track(7), CAR)] * 3
    runs = [measure_run(make_run(*cases, digest="a"), OPTIONS)]
    runs.append(measure_run(make_run(*[replace(c, tracks=Boxes3D.empty()) for c in cases], has_tracks=False), OPTIONS))
    mota = next(row for row in combine_runs(runs) if row.metric == "mota" and row.slice == "all")
    assert (mota.value, mota.counts["gt"], mota.counts["fn"]) == (0.5, 6, 3)
    alone = next(row for row in combine_runs(runs[1:]) if row.metric == "mota" and row.slice == "all")
    assert (alone.value, alone.reason) == (None, "the pipeline gave no tracks")


def test_no_tracks_have_no_intervals(make_run: MakeRun) -> None:
    cases = [Case(track(7), CAR, tracks=Boxes3D.empty(), segment=i // 2) for i in range(20)]
    run = make_run(*cases, has_tracks=False)
    rows = intervals_of_run(run, OPTIONS, list(Tracking().scores(run, OPTIONS)), Bootstrap(0, 20))
    assert all(row.value is None and row.low is None for row in rows)
