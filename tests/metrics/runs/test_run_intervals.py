"""Intervals of one run: over its segments, else over stretches of its time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.metrics.conftest import NO_CAMERA, Case, boxes3d, make_manifest

from fbench.metrics.core.bootstrap import Bootstrap
from fbench.metrics.runs.combine import score_run
from fbench.metrics.runs.detection import Detection
from fbench.metrics.runs.scoring import Pieces, cut_run, intervals_of_run
from fbench.metrics.runs.spaces import views
from fbench.metrics.runs.tracking import Tracking
from fbench.replay.contracts.errors import MetricError
from fbench.replay.data.messages import Truth
from fbench.replay.data.scores import Score, ScoreOptions, load_scores, save_scores
from fbench.replay.runs.folder import FrameRecord, Run, RunWriter

OPTIONS = ScoreOptions()
CAR = boxes3d((10, 0), label="car", ids=[1])
RIGHT, WRONG = boxes3d((10, 0), ids=[7]), boxes3d((30, 0), ids=[8])


def timed_run(folder: Path, cases: list[Case], period_ms: int = 100) -> Run:
    with RunWriter(folder) as writer:
        for i, case in enumerate(cases):
            stamp = i * period_ms * 1_000_000
            writer.add_frame(FrameRecord(i, stamp, case.segment, None, {}, "", ""), {"total": 1})
            writer.add_boxes("detections", i, case.estimates)
            writer.add_boxes("tracks", i, case.estimates)
            if case.truth is not None:
                writer.label_frame(i, Truth(stamp, stamp, case.truth, None))
        return Run(writer.finish(make_manifest(NO_CAMERA)))


def cases(num: int, segments: int = 1) -> list[Case]:
    return [Case(WRONG if i % 3 == 0 else RIGHT, CAR, segment=i * segments // num) for i in range(num)]


def with_intervals(run: Run) -> dict[str, Score]:
    rows = score_run(run, OPTIONS, (Detection(), Tracking()))
    found = intervals_of_run(run, OPTIONS, rows, Bootstrap(num=100))
    assert [replace(row, low=None, high=None, interval=None) for row in found] == rows
    return {row.metric: row for row in reversed(found) if (row.class_, row.slice) == ("vehicle", "all")}


def test_stretches_give_intervals_of_what_steps_tell(tmp_path: Path) -> None:
    rows = with_intervals(timed_run(tmp_path / "run", cases(70)))
    for metric in ("f1", "precision", "recall", "mota", "mota_no_fp", "motp"):
        row = rows[metric]
        assert row.low is not None, metric
        assert row.high is not None
        assert row.low <= (row.value or 0) <= row.high
        assert row.interval == "95 % of 100 bootstrap resamples of 7 stretches of 1 s"
    for metric in ("idf1", "hota", "assa"):
        assert (rows[metric].low, rows[metric].interval) == (None, "stretches of 1 s cut tracks")
    assert rows["idsw"].interval is None


def test_segments_give_intervals_of_tracks_too(tmp_path: Path) -> None:
    rows = with_intervals(timed_run(tmp_path / "run", cases(30, segments=6)))
    for metric in ("f1", "mota", "idf1", "hota"):
        row = rows[metric]
        assert row.low is not None, metric
        assert row.interval == "95 % of 100 bootstrap resamples of 6 segments"


def test_a_short_run_has_a_reason_instead(tmp_path: Path) -> None:
    rows = with_intervals(timed_run(tmp_path / "run", cases(40, segments=2)))
    assert rows["f1"].interval == "4 s with truth in 2 segments, at least 5 s or segments are needed"
    assert rows["f1"].low is None


@pytest.mark.parametrize(("num", "segments", "unit", "count"), [
    (50, 1, "stretches of 1 s", 5), (1000, 1, "stretches of 5 s", 20), (60, 3, "stretches of 1 s", 6),
    (10, 5, "segments", 5),
])  # fmt: skip
def test_pieces(tmp_path: Path, num: int, segments: int, unit: str, count: int) -> None:
    found = cut_run(timed_run(tmp_path / "run", cases(num, segments)), 5)
    assert isinstance(found, Pieces)
    assert found.unit == unit
    assert np.bincount(found.piece).tolist() == [num // count] * count


def test_views_of_pieces_hold_every_box_once(tmp_path: Path) -> None:
    run = timed_run(tmp_path / "run", [*cases(50), Case(RIGHT), *cases(10)])
    cut = cut_run(run, 5)
    assert isinstance(cut, Pieces)
    view = views(run, run.tracks, OPTIONS)[0]
    parts = list(cut.views(view))
    assert sum(part.key.num_frames for part in parts) == view.key.num_frames == 60
    for side in ("truth", "estimates"):
        centers = [getattr(part.sequence, side).center_m for part in parts]
        assert np.concatenate(centers).tolist() == getattr(view.sequence, side).center_m.tolist()
    frames = np.concatenate([part.sequence.steps.frame for part in parts])
    assert frames.tolist() == view.sequence.steps.frame.tolist()


class TestFile:
    ROW = Score("f1", "car", "all", "m", 0.5, None, "1", {"tp": 1})

    def test_intervals_are_written_and_read_back(self, tmp_path: Path) -> None:
        rows = [replace(self.ROW, low=0.25, high=0.75, interval="95 % of 9"), replace(self.ROW, interval="2 logs")]
        save_scores(tmp_path / "a.json", rows)
        assert load_scores(tmp_path / "a.json") == rows

    def test_nothing_is_written_of_what_isnt_there(self, tmp_path: Path) -> None:
        save_scores(tmp_path / "a.json", [self.ROW])
        assert not {"low", "high", "interval"} & set((tmp_path / "a.json").read_text().split('"'))
        assert load_scores(tmp_path / "a.json") == [self.ROW]

    @pytest.mark.parametrize("bad", [{"low": 0.1}, {"low": 0.5, "high": 0.1}, {"low": 0.0, "high": np.inf},
                                     {"low": np.nan, "high": 1.0}])  # fmt: skip
    def test_what_isnt_an_interval_is_refused(self, bad: dict[str, float]) -> None:
        with pytest.raises(MetricError, match="isn't an interval"):
            replace(self.ROW, interval="so", **bad)  # type: ignore[arg-type]
        with pytest.raises(MetricError, match="isn't an interval"):
            replace(self.ROW, low=0.0, high=1.0)
