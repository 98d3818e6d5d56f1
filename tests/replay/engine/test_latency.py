"""Replays in which the pipeline needs time: what is dropped, when results are ready, and what of it is recorded."""

import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pyarrow.parquet as pq
import pytest
from tests.replay.engine.test_run import Passing, content, play
from tests.replay.fakes import MS, UPRIGHT, Echo, FakeLog, cloud, drive, scan

from fbench.replay.contracts.errors import ConfigError, RunError
from fbench.replay.data.rig import Mount, Rig, RigChange
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.engine.service_queue import LatencyModel, OverloadPolicy
from fbench.replay.runs.digest import digest

SLOW = LatencyModel(250 * MS)
LIDAR = SyncParams(reference="lidar")


class Broken(Echo):
    def step(self, frame):
        raise ValueError("no")


class Listing(Echo):
    """Notes which frames it gets."""

    def __init__(self):
        super().__init__()
        self.got = []

    def step(self, frame):
        self.got.append(frame.index)
        return super().step(frame)


class Skipping(Listing):
    """Notes which frames it doesn't get, too."""

    def skip(self, frame):
        self.got.append(-frame.index)


def times(run):
    return [None if f.is_dropped else (f.start_ns // MS, f.done_ns // MS) for f in run.frames]


def test_a_pipeline_may_be_told_what_it_does_not_get(tmp_path):
    pipeline = Skipping()
    play(drive(8), tmp_path / "run", pipeline, latency=SLOW)
    assert pipeline.got == [0, -1, 2, -3, -4, 5, -6, 7]


def test_a_slow_pipeline_does_not_get_all_frames(tmp_path):
    pipeline = Listing()
    run = play(drive(8), tmp_path / "run", pipeline, latency=SLOW)
    assert [f.ready_ns for f in run.frames] == [100 * MS * i for i in range(8)]
    assert times(run) == [(0, 250), None, (250, 500), None, None, (500, 750), None, (750, 1000)]
    assert pipeline.got == [0, 2, 5, 7]
    assert run.manifest.latency.model_dump() == {
        "service_ns": 250 * MS, "overload": "newest", "rate": 1.0, "num_dropped": 4
    }  # fmt: skip
    assert json.loads((run.folder / "faults.json").read_text())["lost"] == 0
    assert run.manifest.complete
    assert [len(run.tracks.at(i)) for i in range(8)] == [1, 0, 1, 0, 0, 1, 0, 1]
    assert run.tracks.at(7).track_id.tolist() == [4]  # the tracker counts the frames that it gets
    assert sorted(run.frame_times["total"]) == [0, 2, 5, 7]
    assert [f.truth_stamp_ns is not None for f in run.frames] == [i % 2 == 0 for i in range(8)]


def test_no_latency_is_lockstep_to_the_byte(tmp_path):
    lockstep, zero = play(drive(), tmp_path / "a"), play(drive(), tmp_path / "b", latency=LatencyModel(0))
    assert "latency" not in (lockstep.folder / "manifest.json").read_text()
    assert "ready_ns" not in pq.read_schema(lockstep.folder / "frames.parquet").names
    ours, theirs = content(zero.folder), content(lockstep.folder)
    assert {name for name in ours if ours[name] != theirs[name]} == {"frames.parquet", "manifest.json"}
    untimed = [replace(f, ready_ns=None, start_ns=None, done_ns=None) for f in zero.frames]
    assert untimed == list(lockstep.frames)
    assert all(f.ready_ns == f.start_ns == f.done_ns for f in zero.frames)
    assert zero.manifest.model_copy(update={"latency": None}) == lockstep.manifest


def test_fixed_latency_gives_equal_bytes_and_a_digest_of_its_own(tmp_path):
    runs = [play(drive(), tmp_path / name, latency=SLOW) for name in ("a", "b")]
    assert content(runs[0].folder) == content(runs[1].folder)
    assert runs[0].frames[1].digest == digest([1, 100 * MS, 0, {}, None, None])
    assert runs[0].manifest.digest != play(drive(), tmp_path / "c").manifest.digest


@pytest.mark.parametrize(
    ("policy", "got"),
    [
        (OverloadPolicy("skip"), [0, 3, 6]),
        (OverloadPolicy("fifo", 1), [0, 1, 3, 5]),
        (OverloadPolicy("fifo", 9), [*range(8)]),
    ],
)
def test_policies(tmp_path, policy, got):
    pipeline = Listing()
    play(drive(8), tmp_path / "run", pipeline, latency=replace(SLOW, policy=policy))
    assert pipeline.got == got


def test_rate_makes_latency_longer_in_log_time(tmp_path):
    twice = play(drive(8), tmp_path / "a", latency=LatencyModel(125 * MS, rate=Fraction(2)))
    assert times(twice) == times(play(drive(8), tmp_path / "b", latency=SLOW))


def test_frames_are_ready_when_complete_or_given_up(tmp_path):
    late = cloud(100 * MS, late_ns=20 * MS)
    log = FakeLog([cloud(0), scan(0), late, scan(100 * MS), cloud(200 * MS), cloud(300 * MS), scan(300 * MS)])
    run = play(log, tmp_path / "run", latency=LatencyModel(0), sync=LIDAR)
    # The third lacks radar until its time-out of 30 ms.
    assert [f.ready_ns // MS for f in run.frames] == [0, 120, 230, 300]


def test_a_frame_is_never_ready_before_earlier_ones(tmp_path):
    items = [cloud(0), cloud(100 * MS), scan(100 * MS), cloud(200 * MS), scan(200 * MS)]
    run = play(FakeLog(items), tmp_path / "run", latency=LatencyModel(0), sync=replace(LIDAR, timeout_ns=150 * MS))
    assert [f.ready_ns // MS for f in run.frames] == [150, 150, 200]


def test_failed_frames_take_their_time_and_dropped_ones_do_not_fail(tmp_path):
    class Failing(Listing):
        def step(self, frame):
            super().step(frame)
            if frame.index == 2:
                raise ValueError("no")
            return Echo.step(self, frame)

    run = play(drive(8), tmp_path / "run", Failing(), latency=SLOW)
    assert [f.index for f in run.frames if f.failed] == [2]
    assert times(run)[2] == (250, 500)
    with pytest.raises(RunError, match="failed on all 1 frame"):
        play(drive(8), tmp_path / "b", Broken(), latency=LatencyModel(10_000 * MS, OverloadPolicy("skip")))


def test_a_segment_begins_with_the_first_frame_that_the_pipeline_gets(tmp_path):
    items = [cloud(t * MS) for t in (0, 100, 3000, 3100, 3200)]
    pipeline = Listing()
    play(FakeLog(items, rig=Rig({"lidar": Mount("lidar", np.zeros(3), UPRIGHT)}, {})), tmp_path / "run", pipeline,
         latency=LatencyModel(3050 * MS))  # fmt: skip
    assert pipeline.got == [0, 2, 4]
    assert pipeline.resets == ["gap of 2.900 s before frame 2"]


def test_a_frame_that_waits_is_worked_on_with_the_rig_that_measured_it(tmp_path):
    other = Rig({"lidar": Mount("lidar", np.ones(3), UPRIGHT)}, {})
    items = [cloud(0), cloud(100 * MS), RigChange(150 * MS, other, ("lidar",)), cloud(200 * MS)]

    class Looking(Listing):
        def step(self, frame):
            rigs[frame.index] = self.rig.mounts["lidar"].translation_m.tolist()
            return super().step(frame)

    class Log(FakeLog):
        def messages(self):
            return iter(self.items)

        @property
        def num_messages(self):
            return {"lidar": 3}

        @property
        def poses(self):
            return ()

    rigs = {}
    log = Log(items, rig=Rig({"lidar": Mount("lidar", np.zeros(3), UPRIGHT)}, {}))
    play(log, tmp_path / "run", Looking(), latency=LatencyModel(150 * MS, OverloadPolicy("fifo", 5)))
    assert rigs == {0: [0, 0, 0], 1: [0, 0, 0], 2: [1, 1, 1]}
    play(log, tmp_path / "newest", Looking(), latency=LatencyModel(150 * MS))
    assert rigs == {0: [0, 0, 0], 1: [0, 0, 0], 2: [1, 1, 1]}


def test_measured_latency_is_that_of_this_run(tmp_path):
    run = play(drive(4), tmp_path / "run", latency=LatencyModel())
    totals = run.frame_times["total"]
    assert {f.index: f.done_ns - f.start_ns for f in run.frames if not f.is_dropped} == totals
    assert run.manifest.latency.service_ns is None


def test_results_computed_elsewhere_have_no_measured_latency(tmp_path):
    with pytest.raises(ConfigError, match="results of pipeline 'echo' were computed elsewhere"):
        play(drive(), tmp_path / "a", Passing(), latency=LatencyModel())
    assert not (tmp_path / "a").exists()
    assert play(drive(), tmp_path / "b", Passing(), latency=SLOW).manifest.latency.num_dropped
