"""Runs together: counts are added, slices by what logs say of themselves."""

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import reduce
from itertools import permutations
from operator import add
from pathlib import Path

import numpy as np
import pytest
from tests.metrics.conftest import Case, boxes3d, front_camera, write_run

from fbench.api.scores import Resampling, ScoreRequest, score
from fbench.cli.score_show import show_together
from fbench.metrics.core.bootstrap import Bootstrap
from fbench.metrics.criticality.scores import RULES
from fbench.metrics.events.scores import ARRIVALS, SLICE
from fbench.metrics.runs.combine import RunStatistics, combine_runs, describe_gaps, measure_run, score_run
from fbench.metrics.runs.detection import Detection
from fbench.metrics.runs.scoring import own_rows
from fbench.metrics.runs.tracking import Tracking
from fbench.replay.contracts.errors import ConfigError, MetricError
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.scores import Score, ScoreOptions, load_scores
from fbench.replay.runs.folder import Run
from fbench.replay.runs.manifest import LogEntry

METRICS = (Detection(), Tracking())
CAR = boxes3d((10, 0), label="car", ids=[1])
WRONG = boxes3d((30, 0), ids=[7])
RIGHT = boxes3d((10, 0), ids=[7])


def written(folder: Path, name: str, cases: list[Case], pipeline: str = "lidar3d", **words: str) -> Run:
    log = LogEntry(name=name, log_id=name, digest="d" * 32, metadata=words)
    return write_run(folder / f"run-{name}", cases, log=log, pipeline=pipeline)


def measured(*runs: Run) -> list[RunStatistics]:
    return [measure_run(run, ScoreOptions()) for run in runs]


def table(rows: list[Score]) -> dict[tuple[str, str, str], Score]:
    """The first of each: in the pipeline's own space."""
    return {(row.metric, row.class_, row.slice): row for row in reversed(rows)}


def test_one_run_scores_as_it_does_alone(tmp_path: Path) -> None:
    run = written(tmp_path, "a", [Case(RIGHT, CAR), Case(WRONG, CAR), Case(RIGHT)], seed="3")
    assert combine_runs(measured(run)) == score_run(run, ScoreOptions(), METRICS)


def test_a_condition_has_the_intervals_of_its_runs_alone(tmp_path: Path) -> None:
    runs = []
    for i in range(12):
        kind = "fog" if i % 2 else "clear"
        far = [Case(RIGHT, CAR)] * 3 + [Case(RIGHT if i > 8 else WRONG, CAR)] * (i % 4)
        runs.append(written(tmp_path, f"run{i:02d}", far, condition=kind))
    how, ones = Bootstrap(num=100), measured(*runs)
    together, fog = table(combine_runs(ones, how)), table(combine_runs(ones[1::2], how))
    for metric in ("horizon_80", "f1", "recall"):
        own, alone = together[metric, "vehicle", "condition fog"], fog[metric, "vehicle", "all"]
        assert own.value is not None
        assert own.low is not None
        assert (own.value, own.low, own.high) == (alone.value, alone.low, alone.high)
    assert together["hota", "vehicle", "condition fog"].low is None  # Only of what depends on single steps
    few = table(combine_runs(ones[:4], how))
    assert few["f1", "vehicle", "condition fog"].interval == "2 logs, at least 5 are needed"


class Detected:
    """Mean number of detections in a frame."""

    def scores(self, run: Run, options: ScoreOptions) -> list[Score]:
        counts = {"boxes": len(run.detections.frames), "frames": len(run.frames), "empty": 0}
        value = counts["boxes"] / counts["frames"]
        return [Score("detected", "vehicle", "all", "none", value, None, "1", counts)]


class Added(Detected):
    def value_of(self, metric: str, counts: Mapping[str, int | float]) -> float | None:
        return counts["boxes"] / counts["frames"] if metric == "detected" else None


@pytest.mark.parametrize("metric", [Detected(), Added()])
def test_metrics_of_plugins_are_there_for_several_runs_too(tmp_path: Path, metric: Detected) -> None:
    runs = [
        written(tmp_path, "a", [Case(RIGHT, CAR)] * 3),
        written(tmp_path, "b", [Case(RIGHT, CAR), Case(RIGHT[:0], CAR)]),
    ]
    parts = [measure_run(run, ScoreOptions(), metrics=(*METRICS, metric)) for run in runs]
    rows = [row for row in combine_runs(parts) if row.metric == "detected"]
    assert [(row.slice, row.counts) for row in rows] == [
        ("all", {"boxes": 4, "frames": 5, "empty": 0}),
        ("log a", {"boxes": 3, "frames": 3, "empty": 0}),
        ("log b", {"boxes": 1, "frames": 2, "empty": 0}),
    ]
    adds = isinstance(metric, Added)
    assert [row.value for row in rows] == [0.8 if adds else None, 1.0, 0.5]
    assert rows[0].reason == (None if adds else "Detected doesn't say what counts of several runs give (value_of)")
    (alone,) = (row for row in combine_runs(parts[:1]) if row.metric == "detected")
    assert [alone] == metric.scores(runs[0], ScoreOptions())
    assert [row for row in combine_runs(parts) if row.metric != "detected"] == combine_runs(measured(*runs))


def test_installed_metrics_score_several_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    info = tmp_path / "outsider-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: outsider\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[fbench.metrics]\ndetected = tests.metrics.runs.test_combine:Added\n")
    monkeypatch.syspath_prepend(tmp_path)
    runs = [written(tmp_path, name, [Case(RIGHT, CAR)] * num) for name, num in (("a", 3), ("b", 1))]
    rows = score(ScoreRequest([run.folder for run in runs])).rows
    (found,) = (row for row in rows if row.metric == "detected" and row.slice == "all")
    assert (found.value, found.counts["frames"]) == (1.0, 4)


def test_counts_are_added_not_ratios_averaged(tmp_path: Path) -> None:
    good = written(tmp_path, "a", [Case(RIGHT, CAR)] * 3)
    bad = written(tmp_path, "b", [Case(WRONG, CAR), Case(WRONG)])
    rows = table(combine_runs(measured(good, bad)))
    f1 = rows["f1", "vehicle", "all"]
    assert (f1.value, f1.counts["tp"], f1.counts["fp"], f1.counts["fn"]) == (0.75, 3, 1, 1)
    assert rows["mota", "vehicle", "all"].value == 0.5
    assert rows["coverage", "all", "all"].counts == {"scored": 4, "frames": 5}
    assert rows["f1", "vehicle", "log a"].value == 1.0
    assert rows["f1", "vehicle", "log b"].value == 0.0
    assert rows["mota", "vehicle", "log a"].value == 1.0


def test_slices_are_by_words_that_differ(tmp_path: Path) -> None:
    words = {"scenario": "urban", "notes": "-" * 50, "weather.lux": "5"}
    runs = [
        written(tmp_path, "a", [Case(RIGHT, CAR)], condition="clear", traffic="low", seed="1", **words),
        written(tmp_path, "b", [Case(WRONG, CAR)], condition="fog", traffic="low", seed="2", **words),
        written(tmp_path, "c", [Case(RIGHT, CAR)], condition="fog", traffic="high", seed="3", **words),
    ]
    rows = table(combine_runs(measured(*runs)))
    slices = {slice_ for metric, _, slice_ in rows if metric == "f1" and not slice_.startswith("range")}
    assert slices == {
        "all", "log a", "log b", "log c", "condition clear", "condition fog", "traffic high", "traffic low"
    }  # fmt: skip
    assert rows["f1", "vehicle", "condition fog"].value == 0.5
    assert rows["idf1", "vehicle", "traffic low"].value == 0.5


def test_the_order_of_runs_changes_nothing(tmp_path: Path) -> None:
    found = zip("abc", [RIGHT, WRONG, WRONG], strict=True)
    runs = measured(*(written(tmp_path, name, [Case(RIGHT, CAR), Case(boxes, CAR)]) for name, boxes in found))
    first, *others = [combine_runs(order) for order in permutations(runs)]
    assert all(rows == first for rows in others)


def test_what_only_some_runs_have_is_kept(tmp_path: Path) -> None:
    van = boxes3d((10, 0), label="van", ids=[1])
    labeled = boxes3d((10, 0), label="car", ids=[7])
    runs = measured(written(tmp_path, "a", [Case(labeled, CAR)]), written(tmp_path, "b", [Case(labeled, van)]),
                    written(tmp_path, "c", [Case(labeled)]))  # fmt: skip
    rows = table(combine_runs(runs))
    assert (rows["recall", "car", "all"].value, rows["recall", "van", "all"].value) == (1.0, 0.0)
    assert rows["f1", "vehicle", "log c"].reason == "no truth"
    assert rows["f1", "vehicle", "all"].value == 1.0


def test_runs_of_different_pipelines_are_refused(tmp_path: Path) -> None:
    runs = measured(written(tmp_path, "a", [Case(RIGHT, CAR)]), written(tmp_path, "b", [Case(RIGHT, CAR)], "radar3d"))
    with pytest.raises(MetricError, match=r"several pipelines \(lidar3d, radar3d\)"):
        combine_runs(runs)
    with pytest.raises(MetricError, match="no run"):
        combine_runs([])
    with pytest.raises(MetricError, match="twice"):
        combine_runs([runs[0], runs[0]])


def test_intervals_over_logs(tmp_path: Path) -> None:
    runs = measured(*(
        written(tmp_path, f"log{i}", [Case(RIGHT if i % 2 else WRONG, CAR), Case(RIGHT, CAR)]) for i in range(5)
    ))  # fmt: skip
    rows = table(combine_runs(runs, Bootstrap(num=100)))
    for metric in ("f1", "mota", "idf1", "hota"):
        row = rows[metric, "vehicle", "all"]
        assert row.low is not None
        assert row.high is not None
        assert row.low <= (row.value or 0) <= row.high
        assert row.interval == "95 % of 100 bootstrap resamples of 5 logs"
    assert rows["f1", "vehicle", "log log1"].low is None
    few = table(combine_runs(runs[:2], Bootstrap(num=100)))["f1", "vehicle", "all"]
    assert (few.low, few.interval) == (None, "2 logs, at least 5 are needed")
    assert [(row.metric, row.value) for row in combine_runs(runs, Bootstrap(num=9))] == [
        (row.metric, row.value) for row in combine_runs(runs)
    ]


def test_the_default_profile_of_runs_is_their_own_scoring(tmp_path: Path) -> None:
    runs = [written(tmp_path, "a", [Case(RIGHT, CAR), Case(WRONG, CAR)]), written(tmp_path, "b", [Case(RIGHT, CAR)])]
    alone = score_run(runs[0], ScoreOptions(), METRICS)
    assert own_rows(runs[:1], None, None) == (alone, [])
    assert own_rows(runs, None, None) == (combine_runs(measured(*runs)), [])
    own = own_rows(runs[:1], Match("bev", 2.0), None)[0]
    assert own == [row for row in alone if row.matching == alone[0].matching]
    rows = table(own_rows(runs[:1], Match("center3d", 2.0), None)[0])
    assert rows["f1", "vehicle", "all"].matching == "center3d 2 m, within 50 m"
    assert rows["motp", "vehicle", "all"].unit == "m"
    rows = table(own_rows(runs[:1], Match("iou3d", 0.5), Bootstrap(num=20))[0])
    assert (rows["motp", "vehicle", "all"].unit, ("distance_error", "vehicle", "all") in rows) == ("iou", False)
    flat = table(own_rows(runs[:1], Match("iou2d", 0.5), None)[0])
    assert flat["f1", "vehicle", "all"].reason == "no cameras"


def test_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = [written(tmp_path, name, [Case(RIGHT, CAR)]) for name in "ab"]
    folders = [run.folder for run in runs]
    result = score(ScoreRequest(folders, resampling=Resampling(20)))
    show_together(result, folders, tmp_path / "all.json", True)
    content = json.loads(capsys.readouterr().out)
    assert content["scores"][0] == {
        "metric": "f1", "class": "vehicle", "slice": "all", "matching": "bev 2 m, within 50 m", "value": 1.0,
        "reason": None, "unit": "1", "counts": {"tp": 2, "fp": 0, "fn": 0, "ignored": 0, "invalid": 0,
                                                 "invalid_truth": 0, "frames": 2},
        "interval": "2 logs, at least 5 are needed",
    }  # fmt: skip
    rows = [row for row in load_scores(tmp_path / "all.json") if not row.slice.startswith(SLICE)]
    own = [row for row in rows if row.metric not in (*RULES, *ARRIVALS)]
    assert own == combine_runs(measured(*runs), Bootstrap(num=20))
    show_together(score(ScoreRequest(folders)), folders, None, False)
    assert "2 runs together" in capsys.readouterr().out
    with pytest.raises(ConfigError, match="no such run folder"):
        score(ScoreRequest([tmp_path / "none"]))


def test_a_word_called_visibility_is_no_slice_by_visibility(tmp_path: Path) -> None:
    runs = [written(tmp_path, name, [Case(RIGHT, CAR)], visibility=how) for name, how in zip("abc", "xyy", strict=True)]
    assert table(combine_runs(measured(*runs)))["f1", "vehicle", "visibility y"].value == 1.0


def test_frames_that_cant_be_scored_in_images_arent_counted_there(tmp_path: Path) -> None:
    seen = write_run(
        tmp_path / "a",
        [Case(RIGHT, CAR)] * 2,
        front_camera(),
        log=LogEntry(name="a", log_id="a", digest="d" * 32, metadata={}),
    )
    other = written(tmp_path, "b", [Case(RIGHT, CAR)] * 3)
    with pytest.raises(ConfigError, match=r"'bev 2 m, within 50 m, in view' on log 'a', .* on log 'b'; --all-around"):
        combine_runs(measured(seen, other))
    runs = [measure_run(run, ScoreOptions(in_view=False)) for run in (seen, other)]
    rows = combine_runs(runs)
    f1 = next(row for row in rows if row.metric == "f1")
    assert (f1.matching, f1.counts["frames"], f1.counts["tp"]) == ("bev 2 m, within 50 m", 5, 5)
    assert describe_gaps(runs) == [
        "rows by 'iou 0.5, truth projected from 3D, within 50 m' are of 1 of 2 runs only: a"
    ]  # fmt: skip
    frames = {row.matching: row.counts["frames"] for row in rows if row.metric == "f1" and row.slice == "all"}
    assert next(num for how, num in frames.items() if how.startswith("iou")) == 2


def test_runs_of_one_frame_each_add_up_to_the_run_of_all(tmp_path: Path) -> None:
    """Bit for bit, as workers would score them."""
    rng = np.random.Generator(np.random.PCG64(7))
    cases = [
        Case(boxes3d(*rng.normal(10, 2, (3, 2)), ids=[1, 2, 3], score=rng.random(3)),
             boxes3d(*rng.normal(10, 2, (3, 2)), label="car", ids=[4, 5, 6]), segment=i)
        for i in range(8)
    ]  # fmt: skip
    whole = measured(written(tmp_path, "whole", cases))[0].table
    parts = [measured(written(tmp_path, f"{i}", [replace(case, segment=0)]))[0].table for i, case in enumerate(cases)]
    for order in (parts, parts[::-1]):
        assert reduce(add, order).rows() == whole.rows()
