"""The loop: what a run folder holds, determinism, failures, truth."""

import hashlib
import json
import os
import random
import re
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.replay.fakes import MS, UPRIGHT, Echo, FakeLog, box, cloud, drive, scan

from fbench.replay.contracts.errors import ConfigError, LogError, RunError
from fbench.replay.contracts.faults import FaultBudget, FaultLog
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.frames import Fault, Output
from fbench.replay.data.messages import PointCloud, Pose, Truth
from fbench.replay.engine.clock import Clock
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan
from fbench.replay.runs.folder import Run
from fbench.replay.runs.tables import BoxWriter

MEASURED = ("timings.parquet", "latency.json", "host.json")


def play(log, folder, pipeline=None, faults=None, **plan):
    run = replay(log, Plan(pipeline or Echo(), "echo", **plan), folder, faults or FaultLog())
    return Run(run)


def content(folder: Path) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file() and p.name not in MEASURED)
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_run_folder_tells_what_happened(tmp_path):
    run = play(drive(), tmp_path / "run")
    assert run.manifest.num_frames == 20
    assert run.manifest.complete
    assert run.manifest.frames.reference == "lidar"
    assert run.manifest.log.metadata == {"place": "here"}
    assert [f.index for f in run.frames] == list(range(20))
    assert run.frames[-1].chain == run.manifest.digest
    assert run.detections.at(3).center_m.tolist() == [[13, 0, 0]]
    assert run.tracks.at(3).track_id.tolist() == [4]
    assert run.timings["detect.lidar"] == [1000] * 20
    assert len(run.timings["total"]) == 20
    assert json.loads((run.folder / "faults.json").read_text())["lost"] == 0


class Passing(Echo):
    """Passes on what was computed elsewhere, and fails on a frame."""

    def step(self, frame):
        if frame.index == 3:
            raise ValueError("no")
        stage_ns = {} if frame.index == 4 else {"detect": 70 * MS, "track": 10 * MS}
        return replace(super().step(frame), clock="log", stage_ns=stage_ns)


def test_times_of_what_was_computed_elsewhere(tmp_path):
    run = play(drive(), tmp_path / "run", Passing())
    assert run.clock == "log"
    assert run.timings == {"detect": [70 * MS] * 18, "track": [10 * MS] * 18, "total": [80 * MS] * 18}
    assert play(drive(), tmp_path / "echo").clock == "host"


def test_truth_belongs_to_its_frames_and_no_others(tmp_path):
    run = play(drive(), tmp_path / "run")
    assert [f.truth_stamp_ns is not None for f in run.frames] == [i % 2 == 0 for i in range(20)]
    assert run.truth3d(2).track_id.tolist() == [7]
    assert run.truth3d(3) is None
    assert run.truth2d(2) is None


def test_truth_joins_by_frame_number_before_stamps(tmp_path):
    items = [replace(cloud(100 * MS * i), frame_number=i + 5) for i in range(3)]
    labels = [Truth(0, 0, box(1.0), frame_number=6), Truth(200 * MS, 0, Boxes3D.empty(), frame_number=99)]
    run = play(FakeLog(items, labels), tmp_path / "run")
    assert [f.truth_stamp_ns for f in run.frames] == [None, 0, None]


def test_frame_with_empty_truth_is_labeled(tmp_path):
    run = play(FakeLog([cloud(0), cloud(100 * MS)], [Truth(0, 0, Boxes3D.empty())]), tmp_path / "run")
    assert len(run.truth3d(0)) == 0
    assert run.truth3d(1) is None


def test_log_without_truth_replays(tmp_path):
    run = play(FakeLog([cloud(0)]), tmp_path / "run")
    assert run.truth3d(0) is None


def test_two_runs_are_byte_equal_at_any_rate(tmp_path):
    paced = Clock(50.0, 2_000 * MS)
    runs = [play(drive(), tmp_path / "a"), play(drive(), tmp_path / "b", clock=paced)]
    assert content(runs[0].folder) == content(runs[1].folder)
    assert len(content(runs[0].folder)) >= 6


def test_one_changed_point_changes_the_frame_and_all_links_after_it(tmp_path):
    log, other = drive(), drive()
    other.items[10] = cloud(500 * MS, 15.5)
    a, b = play(log, tmp_path / "a"), play(other, tmp_path / "b")
    assert [x.digest == y.digest for x, y in zip(a.frames, b.frames, strict=True)] == [i != 5 for i in range(20)]
    assert [x.chain == y.chain for x, y in zip(a.frames, b.frames, strict=True)] == [i < 5 for i in range(20)]
    assert a.manifest.log.digest != b.manifest.log.digest


def test_hash_seed_and_global_generators_do_not_matter(tmp_path, monkeypatch):
    first = play(drive(), tmp_path / "a")
    random.seed(os.urandom(4))
    monkeypatch.setenv("TZ", "Asia/Tokyo")
    time.tzset()
    assert content(play(drive(), tmp_path / "b").folder) == content(first.folder)


def test_segments_reset_the_pipeline(tmp_path):
    pipeline, faults = Echo(), FaultLog()
    items = [cloud(100 * MS * i) for i in (0, 1, 2, 50, 51)]
    run = play(FakeLog(items), tmp_path / "run", pipeline, faults)
    assert [run.tracks.at(i).track_id.tolist() for i in range(5)] == [[1], [2], [3], [1], [2]]
    assert pipeline.resets == ["gap of 4.800 s before frame 3"]
    assert faults.counts["TIM007"] == 1
    assert run.manifest.complete


def test_missing_sensor_says_late_or_never(tmp_path):
    items = [cloud(0), cloud(100 * MS), cloud(200 * MS), scan(0), replace(scan(100 * MS), log_ns=145 * MS)]
    run = play(FakeLog(items), tmp_path / "run", sync=SyncParams(reference="lidar"))
    assert [dict(f.missing) for f in run.frames] == [{}, {"radar": "late by 15.0 ms"}, {"radar": "never came"}]


class Flaky(Echo):
    def __init__(self, bad):
        super().__init__()
        self.bad = bad

    def step(self, frame):
        if frame.index in self.bad:
            raise ValueError("no\nidea")
        return super().step(frame)


def test_failing_frame_is_counted_and_the_rest_goes_on(tmp_path):
    faults = FaultLog()
    run = play(drive(), tmp_path / "run", Flaky({0, 4}), faults)
    assert [f.index for f in run.frames if f.failed] == [0, 4]
    assert run.frames[4].failed.startswith("ValueError: no (test_run.py:")
    assert len(run.detections.at(4)) == 0
    assert faults.counts["PRD002"] == 2
    assert not run.manifest.complete


def test_tolerated_loss_leaves_the_run_complete(tmp_path):
    run = play(drive(), tmp_path / "run", Flaky({4}), budget=FaultBudget(None))
    assert run.manifest.complete
    assert run.json("faults.json")["lost"] == 1


@pytest.mark.parametrize(
    ("num_frames", "message"), [(20, "failed on 10 frames in a row"), (5, "failed on all 5 frames")]
)
def test_pipeline_that_keeps_failing_is_given_up(tmp_path, num_frames, message):
    with pytest.raises(RunError, match=message):
        play(drive(num_frames), tmp_path / "run", Flaky(set(range(100))))
    assert list(tmp_path.iterdir()) == []


class Invalid(Echo):
    def step(self, frame):
        bad = box(np.nan)
        return Output(bad, bad, {}, (Fault("DEC002", "cam at 5 ns"),))


def test_non_finite_boxes_and_reported_faults_are_counted(tmp_path):
    faults = FaultLog()
    run = play(drive(2), tmp_path / "run", Invalid(), faults)
    assert faults.counts["PRD001"] == 4
    assert faults.places["DEC002"][0] == "frame 0: cam at 5 ns"
    assert np.isnan(run.detections.at(0).center_m[0, 0])


class Wrong(Echo):
    def step(self, frame):
        return None


def test_wrong_output_type_is_a_failure(tmp_path):
    with pytest.raises(RunError, match=r"DataError: step\(\) gave NoneType, expected Output"):
        play(drive(3), tmp_path / "run", Wrong())


def test_log_without_the_reference_gives_no_frames(tmp_path):
    with pytest.raises(LogError, match="gives no frames: no message of 'lidar'"):
        play(FakeLog([scan(0)]), tmp_path / "run", sync=SyncParams(reference="lidar"))


def test_existing_folder_is_kept(tmp_path):
    play(drive(2), tmp_path / "run")
    before = content(tmp_path / "run")
    with pytest.raises(ConfigError, match="exists already; choose another with --out, or --overwrite it"):
        play(drive(3), tmp_path / "run")
    assert content(tmp_path / "run") == before


def test_overwrite_replaces_a_run_but_nothing_else(tmp_path):
    play(drive(2), tmp_path / "run")
    replay(drive(3), Plan(Echo(), "echo"), tmp_path / "run", FaultLog(), overwrite=True)
    assert Run(tmp_path / "run").manifest.num_frames == 3
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "thesis.tex").touch()
    with pytest.raises(ConfigError, match="isn't a run folder"):
        replay(drive(3), Plan(Echo(), "echo"), precious, FaultLog(), overwrite=True)
    assert (precious / "thesis.tex").is_file()


def test_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="can't be written"):
        play(drive(2), tmp_path / "file" / "run")


def test_media_are_kept_for_a_few_frames_of_a_log_of_any_length(tmp_path):
    for num_frames in (5, 16, 100):
        run = play(drive(num_frames), tmp_path / f"run{num_frames}", num_media=4)
        kept = [m.index for m in run.media]
        assert min(4, num_frames) <= len(kept) <= 8
        assert len(set(np.diff(kept))) == 1
    first = run.media[0].points
    assert first["radar"].speed_mps.tolist() == [1.0]
    assert first["lidar"].xyz.tolist() == [[10, 0, 0], [11, 0, 0]]


def test_no_media_where_none_are_wanted(tmp_path):
    assert play(drive(3), tmp_path / "run", num_media=0).media == ()


class Posed(Echo):
    def step(self, frame):
        assert "pose" in frame.messages
        return super().step(frame)


def test_frames_wait_for_poses(tmp_path):
    poses = [Pose("pose", 100 * MS * i, (100 * i + 5) * MS, np.zeros(3), UPRIGHT) for i in range(3)]
    run = play(FakeLog([*(cloud(100 * MS * i) for i in range(3)), *poses]), tmp_path / "run", Posed())
    assert [f.failed for f in run.frames] == [None] * 3


class Blind(Echo):
    def step(self, frame):
        return replace(super().step(frame), missing={"camera": "no weights"})


def test_sensor_that_the_pipeline_cannot_use_is_missing_too(tmp_path):
    run = play(FakeLog([cloud(0)]), tmp_path / "run", Blind())
    assert run.frames[0].missing == {"camera": "no weights", "radar": "never came"}


@pytest.mark.parametrize(
    ("numbers", "labels", "expected"),
    [
        ([None] * 3, [Truth(100 * MS, 0, box(1.0), frame_number=9)], [None, 100, None]),
        ([7, 8, 9], [Truth(0, 0, box(1.0), frame_number=9)], [None, None, 0]),
        (
            [7, 8, 7],
            [Truth(1 * MS, 0, box(1.0), frame_number=7), Truth(199 * MS, 0, box(1.0), frame_number=7)],
            [1, None, 199],
        ),
        ([None] * 3, [Truth(91 * MS, 0, box(1.0)), Truth(100 * MS, 0, box(2.0))], [None, 100, None]),
        ([None] * 3, [Truth(100 * MS, 0, box(1.0)), Truth(109 * MS, 0, box(2.0))], [None, 100, None]),
        ([None] * 3, [Truth(89 * MS, 0, box(1.0))], [None, None, None]),
    ],
)
def test_truth_finds_the_right_frame(tmp_path, numbers, labels, expected):
    items = [replace(cloud(100 * MS * i), frame_number=n) for i, n in enumerate(numbers)]
    faults = FaultLog()
    run = play(FakeLog(items, labels), tmp_path / "run", faults=faults)
    found = [None if f.truth_stamp_ns is None else f.truth_stamp_ns // MS for f in run.frames]
    assert found == expected
    assert faults.counts["GT006"] == len(labels) - sum(e is not None for e in expected)


def out(**changes):
    """A step that gives an odd output."""

    class Odd(Echo):
        def step(self, frame):
            return replace(super().step(frame), **changes)

    return Odd()


class Raises(Echo):
    """A pipeline that breaks in one of its methods."""

    def __init__(self, method, error):
        super().__init__()
        self.method, self.error = method, error

    def start(self, rig, log_info):
        if self.method == "start":
            raise self.error
        super().start(rig, log_info)

    def step(self, frame):
        if self.method == "step":
            raise self.error
        return super().step(frame)


LABELLED = replace(box(1.0), label=np.array(["Car"]))
NO_CAMERA = Boxes2D(np.array(["cam"]), np.ones((1, 4)))


@pytest.mark.parametrize(
    ("pipeline", "message"),
    [
        (out(detections=None, tracks=None), "expected Boxes2D or Boxes3D, got NoneType"),
        (out(stage_ns={"a": None}), "Output.stage_ns: expected names and times"),
        (out(clock="wall"), "Output.clock: expected host or log, got 'wall'"),
        (out(missing={"lidar": 3}), "Output.missing: expected texts"),
        (out(faults=(Fault("XYZ", "here"),)), "isn't a fault of the table"),
        (out(detections=LABELLED), "Output.detections.label: 'Car' isn't known; did you mean 'car'"),
        (out(detections=NO_CAMERA, tracks=NO_CAMERA), "Output.detections.camera: 'cam' isn't known"),
        (Raises("start", ZeroDivisionError("oh")), "can't start: ZeroDivisionError: oh"),
        (Raises("step", SystemExit(0)), "failed on all 3 frames: SystemExit: 0"),
    ],
)
def test_pipelines_that_break_their_contract(tmp_path, pipeline, message):
    with pytest.raises(RunError, match=re.escape(message)):
        play(drive(3), tmp_path / "run", pipeline)
    assert list(tmp_path.iterdir()) == []


class Mixed(Echo):
    def step(self, frame):
        output = super().step(frame)
        return output if frame.index else Output(Boxes2D.empty(), Boxes2D.empty(), {})


def test_boxes_are_of_one_kind_throughout(tmp_path):
    run = play(drive(5), tmp_path / "run", Mixed())
    assert run.frames[0].failed is None
    assert "expected Boxes2D as in other frames" in run.frames[1].failed


def test_failing_score_leaves_nothing_behind(tmp_path):
    def complete(folder):
        assert (folder / "manifest.json").is_file()
        raise RunError("no")

    with pytest.raises(RunError, match="no"):
        replay(drive(2), Plan(Echo(), "echo"), tmp_path / "run", FaultLog(), complete=complete)
    assert list(tmp_path.iterdir()) == []


def test_foreign_manifest_is_not_a_run(tmp_path):
    web = tmp_path / "web"
    web.mkdir()
    (web / "manifest.json").write_text('{"name": "my site"}')
    with pytest.raises(ConfigError, match="isn't a run folder"):
        replay(drive(2), Plan(Echo(), "echo"), web, FaultLog(), overwrite=True)
    assert (web / "manifest.json").is_file()


def test_frames_without_boxes_take_no_memory(tmp_path):
    writer = BoxWriter(tmp_path / "t.parquet", Boxes3D)
    writer.add(0, Boxes3D.empty())
    tracemalloc.start()
    for i in range(5000):
        writer.add(i, Boxes3D.empty())
    used, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    writer.close()
    assert used < 1_000_000


def test_lost_truth_table_is_not_taken_for_no_truth(tmp_path):
    run = play(drive(), tmp_path / "run")
    (run.folder / "truth.parquet").unlink()
    with pytest.raises(RunError, match=r"truth.parquet: can't be read \(frames have truth, but it isn't there\)"):
        Run(run.folder).truth3d(0)


def test_cloud_that_was_skipped_is_said_to_be(tmp_path):
    broken = PointCloud("lidar", 0, 0, np.full((3, 3), np.nan, np.float32))
    run = play(FakeLog([broken, cloud(100 * MS), scan(0), scan(100 * MS)]), tmp_path / "run")
    assert run.frames[0].missing == {"lidar": "skipped: mostly non-finite points"}
    assert run.frames[1].missing == {}
