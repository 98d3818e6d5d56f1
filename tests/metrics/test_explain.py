"""What became of each box of a frame, by hand."""

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.metrics.conftest import Case, MakeRun, boxes2d, boxes3d, front_camera

from fbench.cli.score_show import explain_run
from fbench.metrics.explanation import Explanation, Verdict, explain_frame
from fbench.metrics.runs.detection import detection_entries
from fbench.metrics.runs.tracking import tracking_entries
from fbench.replay.contracts.errors import ConfigError, MetricError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.runs.folder import Run

OPTIONS = ScoreOptions()
NOTHING = Boxes3D.empty()
Said = list[tuple[str, str]]


def said(
    run: Run, frame: int = 0, table: int = 0, options: ScoreOptions = OPTIONS, class_: str = "vehicle"
) -> tuple[Said, Said]:
    """Outcome and reason of truth, then of estimates; boxes are ordered by x."""
    found = explain_frame(run, options, frame, class_).tables[table]
    return tuple([(v.outcome, v.reason) for v in side] for side in (found.truth, found.estimates))  # type: ignore[return-value]


def test_hits_misses_and_false_alarms(make_run: MakeRun) -> None:
    run = make_run(Case(boxes3d((10.5, 0), (23.4, 0), score=[0.9, 0.8]), boxes3d((10, 0), (20, 0), label="car")))
    assert said(run) == (
        [("hit", "detection 0 is on it, 0.50 m away"),
         ("missed", "no detection within 2 m; nearest is detection 1, 3.40 m away")],
        [("hit", "on truth 0, 0.50 m away"),
         ("false alarm", "no truth within 2 m; nearest is truth 1, 3.40 m away")],
    )  # fmt: skip


def test_who_took_it(make_run: MakeRun) -> None:
    """The better score is on the truth between; the other estimate comes too late, the other truth goes without."""
    run = make_run(Case(boxes3d((10.2, 0), (10.9, 0), score=[0.5, 0.9]), boxes3d((10.6, 0), label="car")))
    assert said(run)[1] == [
        ("false alarm", "truth 0, 0.40 m away, is taken by detection 1"), ("hit", "on truth 0, 0.30 m away")
    ]  # fmt: skip
    run = make_run(Case(boxes3d((11, 0)), boxes3d((10, 0), (11.2, 0), label="car")))
    assert said(run)[0][0] == ("missed", "detection 0, 1.00 m away, is on truth 1")


def test_empty_sides(make_run: MakeRun) -> None:
    car = boxes3d((10, 0), label="car")
    assert said(make_run(Case(NOTHING, car)))[0] == [("missed", "no detection in this frame")]
    assert said(make_run(Case(car, NOTHING)))[1] == [("false alarm", "no truth to be found in this frame")]
    assert said(make_run(Case(NOTHING, NOTHING))) == ([], [])


def test_what_is_ignored(make_run: MakeRun) -> None:
    truth = boxes3d((10, 0), (20, 0), (60, 0), label=["car", "pedestrian", "car"], ignore=[True, False, False])
    found = boxes3d((10, 1), (20, 1), (60, 0), (70, 0))
    assert said(make_run(Case(found, truth))) == (
        [("ignored", "marked as ignored"), ("ignored", "not of class vehicle: pedestrian"),
         ("ignored", "outside of the region: 60.0 m away, and it ends at 50 m")],
        [("ignored", "on truth 0, which needn't be found: marked as ignored"),
         ("ignored", "on truth 1, which needn't be found: not of class vehicle: pedestrian"),
         ("ignored", "outside of the region: 60.0 m away, and it ends at 50 m"),
         ("ignored", "outside of the region: 70.0 m away, and it ends at 50 m")],
    )  # fmt: skip


def test_what_no_camera_sees(make_run: MakeRun) -> None:
    behind = boxes3d((-10, 0), label="car")
    run = make_run(Case(behind, behind), rig=front_camera())
    assert said(run)[0] == [("ignored", "outside of the region: no camera sees its center")]


def test_other_labels_and_classes(make_run: MakeRun) -> None:
    run = make_run(Case(boxes3d((10, 0), label="pedestrian"), boxes3d((10, 0), label="car")))
    assert said(run)[1] == [("ignored", "labelled pedestrian, which isn't scored as vehicle")]
    assert said(run, class_="pedestrian")[1] == [("false alarm", "no truth to be found in this frame")]
    run = make_run(Case(boxes3d((10, 0)), boxes3d((10, 0), label="pedestrian")))
    assert said(run, class_="pedestrian")[1] == [("ignored", "without a class, which isn't scored as pedestrian")]
    with pytest.raises(ConfigError, match="unknown class 'vehicel'; did you mean 'vehicle'"):
        said(run, class_="vehicel")


def test_what_is_invalid(make_run: MakeRun) -> None:
    bad = boxes3d((np.nan, 0), (10, 0), (20, 0), (30, 0), score=[0.5, np.inf, 0.5, 0.5])
    size, yaw = np.array(bad.size_lwh_m), np.array(bad.yaw_rad)
    size[2, 0], yaw[3] = -1.0, np.inf
    run = make_run(Case(replace(bad, size_lwh_m=size, yaw_rad=yaw), boxes3d((np.nan, 0), label="car")))
    assert explain_frame(run, OPTIONS, 0).num_invalid_truth == 1
    assert Counter(said(run)[1]) == Counter([
        ("invalid", "its center isn't finite"), ("invalid", "its score isn't finite"),
        ("invalid", "its size is negative"), ("invalid", "its heading isn't finite"),
    ])  # fmt: skip


def test_tracks_and_switches(make_run: MakeRun) -> None:
    car = boxes3d((10, 0), label="car", ids=[1])
    names = [7, 7, 0, 9]
    cases = [Case(boxes3d((10, 0), ids=[name]) if name else NOTHING, car) for name in names]
    run = make_run(*cases)
    assert said(run, 1, 1)[1] == [("hit", "on truth 0, 0.00 m away")]
    assert said(run, 2, 1)[0] == [("missed", "no track in this frame")]
    assert said(run, 3, 1)[1] == [("hit", "on truth 0, 0.00 m away; id switch: was 7 at frame 1")]
    assert said(run, 3, 0)[1] == [("hit", "on truth 0, 0.00 m away")]


def test_images(make_run: MakeRun) -> None:
    truth = boxes2d((0, 0, 10, 10), (0, 0, 10, 10), camera=["a", "b"], label="car", distance=[30, 40])
    found = boxes2d((0, 0, 10, 8), camera="a", distance=[np.nan])
    run = make_run(Case(found, truth2d=truth), rig=front_camera("a", "b"))
    table = explain_frame(run, OPTIONS, 0).tables[0]
    assert [(v.camera, v.outcome, v.reason, v.range_m) for v in (*table.truth, *table.estimates)] == [
        ("a", "hit", "detection 0 is on it, IoU 0.80", 30.0), ("b", "missed", "no detection in this image", 40.0),
        ("a", "hit", "on truth 0, IoU 0.80", None),
    ]  # fmt: skip
    assert table.estimates[0].similarity == pytest.approx(0.8)


def test_all_fields(make_run: MakeRun) -> None:
    truth = boxes3d((3, 4), label="car", ids=[5])
    run = make_run(Case(boxes3d((3, 5), score=[0.5], ids=[9]), truth))
    table = explain_frame(run, OPTIONS, 0).tables[1]
    assert table.truth == (
        Verdict("truth", 0, "", "car", "hit", "track 0 is on it, 1.00 m away", 5, None, 5.0, 0, 9, 1.0),
    )
    (track,) = table.estimates
    assert (track.class_, track.track_id, track.score, track.partner, track.partner_id) == ("", 9, 0.5, 0, 5)


def test_frames_that_cant_be_explained(make_run: MakeRun) -> None:
    car = boxes3d((10, 0), label="car", ids=[1])
    run = make_run(Case(car, car), Case(car))
    with pytest.raises(ConfigError, match="no frame 9; frames are 0 to 1"):
        explain_frame(run, OPTIONS, 9)
    with pytest.raises(MetricError, match="frame 1 isn't scored: it has no truth"):
        explain_frame(run, OPTIONS, 1)
    with pytest.raises(MetricError, match="isn't scored: no truth"):
        explain_frame(make_run(Case(car)), OPTIONS, 0)
    twice = boxes3d((10, 0), (20, 0), ids=[1, 1])
    with pytest.raises(MetricError, match="id 1 twice"):
        explain_frame(make_run(Case(twice, car)), OPTIONS, 0)


def test_printed(make_run: MakeRun, capsys: pytest.CaptureFixture[str]) -> None:
    truth = boxes3d((10, 0), (60, 0), label="car", ids=[1, 2])
    run = make_run(Case(boxes3d((30, 0), ids=[3]), truth))
    explain_run(run.folder, OPTIONS, 0, "vehicle", True)
    content = json.loads(capsys.readouterr().out)
    assert content["tables"][0]["truth"][0]["outcome"] == "missed"
    assert content["tables"][1]["estimates"][0]["class"] == ""
    explain_run(run.folder, OPTIONS, 0, "vehicle", False)
    out = capsys.readouterr().out
    assert "missed" in out
    assert "truth that needn't be found: 1 outside of the region (each of them with --json)" in out


def outcomes(told: Explanation, table: int) -> tuple[int, int, int, int]:
    """(tp, fp, fn, ignored)."""
    own = told.tables[table]
    num = Counter(verdict.outcome for verdict in own.estimates)
    missed = sum(verdict.outcome == "missed" for verdict in own.truth)
    return num["hit"], num["false alarm"] + num["invalid"], missed, num["ignored"]


BOXES = st.lists(st.tuples(st.integers(0, 28), st.sampled_from([0, 1, 3])), max_size=5)


@pytest.mark.slow
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.lists(st.tuples(BOXES, BOXES), min_size=1, max_size=3))
def test_explanations_add_up_to_the_scores(make_run: MakeRun, frames: list[tuple[list, list]]) -> None:  # type: ignore[type-arg]
    cases = [
        Case(boxes3d(*((2.0 * x, y) for x, y in found), ids=range(len(found)), score=np.linspace(0.1, 0.9, len(found))),
             boxes3d(*((2.0 * x, y) for x, y in truth), ids=range(len(truth)), label="car",
                     ignore=[x % 7 == 0 for x, _ in truth]))
        for truth, found in frames
    ]  # fmt: skip
    run = make_run(*cases)
    told = [explain_frame(run, OPTIONS, frame) for frame in range(len(cases))]
    found, tracked = detection_entries(run, OPTIONS)[0].counts, tracking_entries(run, OPTIONS)[0].counts
    for table, n in enumerate((found.boxes, tracked.boxes)):
        sums = [sum(column) for column in zip(*(outcomes(one, table) for one in told), strict=True)]
        assert sums == [n.tp, n.fp, n.fn, n.ignored]
    switches = sum("id switch" in verdict.reason for one in told for verdict in one.tables[1].estimates)
    assert switches == tracked.clear.switches
