"""Logs without any measurement: frames are the instants of their boxes."""

import sys
from pathlib import Path

import numpy as np
import pytest
from tests.reports.conftest import Page

from fbench.cli import main
from fbench.datasets.importing.run import import_one
from fbench.replay.check.log_check import CheckOptions, check_log
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import ImportRequest, OtherResult
from fbench.replay.contracts.plugins import give_log, make_pipeline
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import Truth
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan
from fbench.replay.logs.open import open_log
from fbench.replay.runs.folder import Run
from fbench.reports.html.page import page

PERIOD_NS = 100_000_000
CAMERA = Mount("camera", np.zeros(3), np.array([0.5, -0.5, 0.5, -0.5]))


def boxes3d(x_m, track_id):
    one = np.ones(1)
    return Boxes3D(
        np.array([[x_m, 0.0, 0.0]]), np.array([[4.0, 2, 1.5]]), 0 * one, label=np.array(["car"]),
        track_id=np.array([track_id]), score=one,
    )  # fmt: skip


def boxes2d(left_px):
    return Boxes2D(np.array(["cam"]), np.array([[left_px, 10.0, left_px + 20, 30]]), label=np.array(["car"]))


class Labels:
    """One sequence of labels and results for ten frames, of which the fourth has no result."""

    name = "labels"
    info = LogInfo("labels", "labels-1", {})
    rig = Rig({"cam": CAMERA}, {"cam": CameraModel(np.eye(3), (200, 100))})
    num_items = 20

    def items(self):
        for i in range(10):
            stamp_ns = (i + 1) * PERIOD_NS
            yield Truth(stamp_ns, stamp_ns, boxes3d(10.0 + i, 7), boxes2d(5.0 + i), i)
            found = Boxes3D.empty() if i == 3 else boxes3d(10.5 + i, 1)
            yield OtherResult(Truth(stamp_ns, stamp_ns, found, boxes2d(6.0 + i), i))

    def summary(self):
        return ["ten frames"]


class Importer:
    def names(self, source):
        return ["labels"]

    def recordings(self, source, asked: ImportRequest):
        yield Labels()


@pytest.fixture(params=["mcap", "parquet"])
def log(request, tmp_path) -> Path:
    out = tmp_path / f"log.{request.param}"
    assert import_one(Importer(), tmp_path, out).lines == ["ten frames"]
    return out


def run(log, folder, name="recorded", **plan):
    pipeline, _ = make_pipeline(name, [])
    give_log(pipeline, name, lambda: open_log(log, FaultLog()))
    return Run(replay(open_log(log, FaultLog()), Plan(pipeline, name, **plan), folder, FaultLog()))


def test_results_are_replayed_with_the_instants_of_the_truth(log, tmp_path):
    done = run(log, tmp_path / "run")
    assert [(f.stamp_ns, f.frame_number) for f in done.frames] == [((i + 1) * PERIOD_NS, i) for i in range(10)]
    assert done.manifest.frames.reference == "boxes"
    assert [done.detections.at(i).center_m[:, 0].tolist() for i in range(5)] == [[10.5], [11.5], [12.5], [], [14.5]]
    assert done.truth3d(9).track_id.tolist() == [7]


def test_results_in_images_have_a_topic_of_their_own(log, tmp_path):
    done = run(log, tmp_path / "run", "recorded:/results/boxes_2d")
    assert [done.detections.at(i).xyxy_px[0, 0] for i in range(10)] == [6.0 + i for i in range(10)]


def test_both_containers_give_the_same_run(tmp_path):
    for form in ("mcap", "parquet"):
        import_one(Importer(), tmp_path, tmp_path / f"log.{form}")
    runs = [run(tmp_path / f"log.{form}", tmp_path / form) for form in ("mcap", "parquet")]
    assert runs[0].manifest.digest == runs[1].manifest.digest
    assert runs[0].manifest.log.digest == runs[1].manifest.log.digest


def test_check_sees_the_same_frames(log):
    reader = open_log(log, FaultLog())
    result = check_log(reader, FaultLog(), CheckOptions())
    assert result.reference == "boxes"
    assert result.frames.num_frames == result.num_labeled == 10
    assert [(f.code, f.severity) for f in result.findings] == [("CHK005", "info")]


def test_a_run_in_which_nothing_was_timed_says_so(log, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["fbench", "replay", str(log), "-p", "recorded", "-o", str(tmp_path / "run")])
    with pytest.raises(SystemExit) as end:
        main()
    text = capsys.readouterr().out
    assert not end.value.code
    assert "latency: nothing was timed" in text
    assert "budget" not in text


def test_a_report_shows_boxes_where_nothing_was_measured(log, tmp_path):
    frames = Page(page([run(log, tmp_path / "run")])).frames()
    assert [frame["index"] for frame in frames] == list(range(10))
    assert [len(frame["truth"]) for frame in frames] == [1] * 10
    assert [len(frame["tracks"]) for frame in frames] == [1, 1, 1, 0, 1, 1, 1, 1, 1, 1]
