"""Curves, objects and frames that reports draw, by hand, and as the scores count them."""

import numpy as np
import pytest
from tests.metrics.conftest import Case, MakeRun, boxes3d

from fbench.metrics.runs.details import MOST_POINTS, find_details
from fbench.metrics.runs.detection import detection_entries
from fbench.metrics.runs.tracking import tracking_entries
from fbench.replay.contracts.errors import RunError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.details import Details, FrameErrors, Span, load_details, save_details
from fbench.replay.data.scores import ScoreOptions

OPTIONS = ScoreOptions()
CAR = boxes3d((10, 0), label="car", ids=[1])
NOTHING = Boxes3D.empty()


def track(number: int) -> Boxes3D:
    return boxes3d((10, 0), ids=[number])


def test_an_object_over_time(make_run: MakeRun) -> None:
    """Missed, on track 7 for two frames, lost, back on 7, then switched to 8: the first miss is no fragment."""
    run = make_run(*(Case(found, CAR) for found in (NOTHING, track(7), track(7), NOTHING, track(7), track(8))))
    (car,) = find_details(run, OPTIONS).objects
    assert (car.label, car.track_id, car.num_frames, car.num_missed) == ("car", 1, 6, 2)
    assert (car.num_switches, car.num_fragments, car.range_m) == (1, 1, 10.0)
    assert car.spans == (Span(0, 0, None), Span(1, 2, 7), Span(3, 3, None), Span(4, 4, 7), Span(5, 5, 8))


def test_lost_objects_come_first(make_run: MakeRun) -> None:
    truth = boxes3d((10, 0), (20, 0), label="car", ids=[1, 2])
    objects = find_details(make_run(Case(track(7), truth)), OPTIONS).objects
    assert [(one.track_id, one.num_missed) for one in objects] == [(2, 1), (1, 0)]


def test_errors_by_frame(make_run: MakeRun) -> None:
    found = boxes3d((10, 0), (30, 0))
    run = make_run(Case(found, CAR), Case(NOTHING, CAR), Case(found), Case(NOTHING, NOTHING))
    assert find_details(run, OPTIONS).frames == FrameErrors((0, 1, 3), (1, 0, 0), (1, 0, 0), (0, 1, 0))


def test_curve_by_hand(make_run: MakeRun) -> None:
    """Hit at 0.9, false alarm at 0.5, hit at 0.3; one of three cars is missed."""
    truth = boxes3d((10, 0), (20, 0), (40, 0), label="car")
    found = boxes3d((10, 0), (30, 0), (20, 0), score=[0.9, 0.5, 0.3])
    curve = find_details(make_run(Case(found, truth)), OPTIONS).curves[0]
    assert curve.threshold == (0.9, 0.5, 0.3)
    assert curve.precision == (1.0, 0.5, 0.666667)
    assert curve.recall == (0.333333, 0.333333, 0.666667)
    assert curve.f1 == (0.5, 0.4, 0.666667)


def test_long_curves_keep_their_best_point_and_both_ends(make_run: MakeRun) -> None:
    rng = np.random.Generator(np.random.Philox(3))
    places = rng.uniform(-20, 20, (900, 2)).tolist()
    run = make_run(Case(boxes3d(*places, score=rng.uniform(0, 1, 900).tolist()), boxes3d(*places[:400], label="car")))
    curve, entry = find_details(run, OPTIONS).curves[0], detection_entries(run, OPTIONS)[0]
    assert MOST_POINTS <= len(curve.f1) <= MOST_POINTS + 1
    assert max(curve.f1) == pytest.approx(entry.counts.ranking.best_f1()[0], abs=1e-6)
    assert (curve.threshold[0], curve.threshold[-1]) == pytest.approx(entry.counts.ranking.scores[[0, -1]], abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_sums_are_those_of_the_scores(make_run: MakeRun, seed: int) -> None:
    rng = np.random.Generator(np.random.Philox(seed))

    def boxes(num: int) -> Boxes3D:
        ids = rng.permutation(num).tolist()
        return boxes3d(*rng.uniform(-8, 8, (num, 2)).tolist(), label="car", ids=ids)

    run = make_run(*(Case(boxes(9), boxes(6)) for _ in range(6)))
    details = find_details(run, OPTIONS)
    detected, tracked = detection_entries(run, OPTIONS)[0].counts.boxes, tracking_entries(run, OPTIONS)[0].counts
    frames = details.frames
    assert (sum(frames.tp), sum(frames.fp), sum(frames.fn)) == (detected.tp, detected.fp, detected.fn)
    assert sum(one.num_missed for one in details.objects) == tracked.boxes.fn
    assert sum(one.num_switches for one in details.objects) == tracked.clear.switches


def test_round_trip_and_damage(make_run: MakeRun) -> None:
    run = make_run(Case(track(7), CAR), Case(NOTHING, CAR))
    assert load_details(run.folder) is None
    details = find_details(run, OPTIONS)
    save_details(run.folder, details)
    assert load_details(run.folder) == details
    (run.folder / "details.json").write_text("[]")
    with pytest.raises(RunError, match=r"details\.json: no details of scores .+; score the run again$"):
        load_details(run.folder)


def test_without_truth_there_are_none(make_run: MakeRun) -> None:
    assert find_details(make_run(Case(track(7))), OPTIONS) == Details()
