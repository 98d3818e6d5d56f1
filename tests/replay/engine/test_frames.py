"""Parts of a log: the chosen frames are those of the whole log, and no more is read than they need."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.replay.fakes import MS, Echo, FakeLog, box, cloud, drive, scan

from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output
from fbench.replay.data.messages import Truth
from fbench.replay.engine.clock import Clock
from fbench.replay.engine.excerpt import Excerpt, make_excerpt
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.engine.frames import FrameStream
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan
from fbench.replay.logs.setup import StampParams
from fbench.replay.runs.folder import Run


class Stateless(Echo):
    """Gives the same for a frame whatever was before."""

    def step(self, frame):
        found = super().step(frame).detections
        return Output(found, Boxes3D.empty(), {})


class Counting(FakeLog):
    """Tells how many messages were taken from it."""

    taken = 0

    def messages(self):
        for message in super().messages():
            self.taken += 1
            yield message


def play(log, folder, pipeline=None, faults=None, **plan):
    return Run(replay(log, Plan(pipeline or Stateless(), "p", **plan), folder, faults or FaultLog()))


def long_drive(num_frames=60):
    return Counting(**{name: getattr(drive(num_frames), name) for name in ("items", "labels", "rig", "info")})


CASES = [
    (None, None, "30:40", range(30, 40)),
    (None, None, "58:", range(58, 60)),
    (None, None, "5", [5]),
    ("3", "3.95", None, range(30, 40)),
    ("5.85", None, None, [59]),
    (f"{3000 * MS}ns", f"{3001 * MS}ns", None, [30]),
    ("3", None, "35:1000", range(35, 60)),
]


@pytest.mark.parametrize(("from_", "to", "frames", "expected"), CASES)
def test_part_equals_the_slice_of_the_whole(tmp_path, from_, to, frames, expected):
    whole = play(long_drive(), tmp_path / "whole")
    part = play(long_drive(), tmp_path / "part", excerpt=make_excerpt(from_, to, frames))
    assert [f.index for f in part.frames] == list(expected)
    assert [replace(f, chain="") for f in part.frames] == [replace(whole.frames[i], chain="") for i in expected]
    for i in expected:
        assert part.detections.at(i).center_m.tolist() == whole.detections.at(i).center_m.tolist()
        assert (part.truth3d(i) is None) == (whole.truth3d(i) is None)
    assert part.manifest.num_frames == len(expected)


def test_truth_of_other_frames_is_no_fault(tmp_path):
    log = long_drive()
    log.labels.append(Truth(3_555 * MS, 0, box(1.0)))
    log.labels.sort(key=lambda truth: truth.stamp_ns)
    inside, outside = FaultLog(), FaultLog()
    play(log, tmp_path / "a", faults=inside, excerpt=Excerpt(30, 40))
    play(log, tmp_path / "b", faults=outside, excerpt=Excerpt(40, 50))
    assert inside.counts["GT006"] == 1
    assert outside.counts["GT006"] == 0


def test_reading_stops_behind_the_last_frame(tmp_path):
    by_index, by_time = long_drive(), long_drive()
    play(by_index, tmp_path / "a", excerpt=Excerpt(2, 4))
    play(by_time, tmp_path / "b", excerpt=make_excerpt("0.2", "0.35", None))
    assert by_index.taken == 8
    assert by_time.taken <= 10


def test_truth_far_behind_the_last_frame_is_not_read(tmp_path):
    log = long_drive()
    run = play(log, tmp_path / "run", excerpt=Excerpt(2, 4))
    full = play(log, tmp_path / "full")
    assert run.manifest.log.digest != full.manifest.log.digest
    log.labels.pop()
    assert play(log, tmp_path / "again", excerpt=Excerpt(2, 4)).manifest.digest == run.manifest.digest
    assert Run(tmp_path / "again").manifest.log.digest == run.manifest.log.digest


def test_trackers_start_with_the_first_frame_of_the_part(tmp_path):
    pipeline = Echo()
    run = play(long_drive(), tmp_path / "run", pipeline, excerpt=Excerpt(30, 33))
    assert pipeline.resets == ["replay begins with frame 30"]
    assert [run.tracks.at(i).track_id.tolist() for i in (30, 31, 32)] == [[1], [2], [3]]


def test_part_in_a_later_segment(tmp_path):
    items = [cloud(100 * MS * i) for i in (0, 1, 50, 51, 52)]
    pipeline = Echo()
    run = play(FakeLog(items), tmp_path / "run", pipeline, excerpt=Excerpt(3))
    assert [(f.index, f.segment) for f in run.frames] == [(3, 1), (4, 1)]
    assert run.manifest.num_segments == 1
    assert pipeline.resets == ["replay begins with frame 3"]


def test_segment_within_a_part_resets_as_in_the_whole(tmp_path):
    items = [cloud(100 * MS * i) for i in (0, 1, 50, 51)]
    pipeline = Echo()
    play(FakeLog(items), tmp_path / "run", pipeline, excerpt=Excerpt(1))
    assert pipeline.resets == ["replay begins with frame 1", "gap of 4.900 s before frame 2"]


def test_what_comes_late_behind_the_end_is_not_called_absent(tmp_path):
    late = replace(scan(100 * MS), log_ns=205 * MS)
    items = [cloud(0), scan(0), cloud(100 * MS), late, cloud(200 * MS)]
    sync = SyncParams(reference="lidar")
    assert play(FakeLog(items), tmp_path / "a", sync=sync).frames[1].missing == {"radar": "late by 75.0 ms"}
    part = play(FakeLog(items), tmp_path / "b", sync=sync, excerpt=Excerpt(0, 2))
    assert part.frames[1].missing == {"radar": "not there within 30 ms"}


@pytest.mark.parametrize("frames", ["60:70", "1000"])
def test_part_without_frames_is_an_error(tmp_path, frames):
    with pytest.raises(LogError, match=r"'fake' has no frames in the range 'frames \d+:\d+'; it has 60 over 5.900 s"):
        play(long_drive(), tmp_path / "run", excerpt=make_excerpt(None, None, frames))
    assert list(tmp_path.iterdir()) == []


def test_manifest_tells_what_was_chosen(tmp_path):
    stamps = StampParams("log", {"radar": 2 * MS})
    entry = play(
        long_drive(), tmp_path / "a", excerpt=Excerpt(3, 5), stamps=stamps, topics=("lidar", "radar")
    ).manifest.frames
    assert (entry.excerpt, entry.stamps, entry.offsets_ns, entry.topics) == (
        "frames 3:5", "log", {"radar": 2 * MS}, ["lidar", "radar"],
    )  # fmt: skip
    assert play(long_drive(), tmp_path / "b").manifest.frames.excerpt == "all"


def test_frames_before_the_part_are_not_waited_for(tmp_path):
    slept = []
    clock = Clock(1.0, 2_000 * MS, lambda: round(sum(slept) * 1e9), slept.append)
    play(long_drive(), tmp_path / "run", excerpt=Excerpt(30, 33), clock=clock)
    assert sum(slept) == pytest.approx(0.2)


def test_offsets_and_log_time_move_instants(tmp_path):
    items = [
        *(cloud(100 * MS * i, late_ns=7 * MS) for i in range(3)),
        *(scan(100 * MS * i + 60 * MS) for i in range(3)),
    ]
    plain = play(FakeLog(items), tmp_path / "a", sync=SyncParams(reference="lidar", timeout_ns=80 * MS))
    assert plain.frames[1].missing == {}
    moved = StampParams(offsets_ns={"radar": -60 * MS})
    run = play(FakeLog(items), tmp_path / "b", sync=SyncParams(reference="lidar", timeout_ns=80 * MS), stamps=moved)
    assert [f.missing for f in run.frames] == [{}, {}, {}]
    logged = play(FakeLog(items), tmp_path / "c", stamps=StampParams("log"))
    assert [f.stamp_ns // MS for f in logged.frames] == [7, 107, 207]


def test_truth_belongs_to_the_recorded_instant(tmp_path):
    items = [cloud(100 * MS * i, late_ns=60 * MS) for i in range(3)]
    log = FakeLog(items, [Truth(100 * MS, 0, box(1.0))])
    for name, stamps in (("a", StampParams("log")), ("b", StampParams(offsets_ns={"lidar": 40 * MS}))):
        run = play(log, tmp_path / name, stamps=stamps)
        assert [f.truth_stamp_ns for f in run.frames] == [None, 100 * MS, None]


def test_unknown_sensor_with_an_offset(tmp_path):
    with pytest.raises(ConfigError, match="--offset radr: no such sensor; did you mean 'radar'"):
        play(drive(2), tmp_path / "run", stamps=StampParams(offsets_ns={"radr": 1}))


# --- nothing with dt <= 0 ever reaches a tracker ---

sensors = st.sampled_from(("lidar", "radar"))
stamps_ns = st.one_of(
    st.integers(0, 60).map(lambda i: 50 * MS * i), st.integers(0, 4_000 * MS), st.sampled_from([0, 100 * MS])
)
arrivals = st.lists(st.tuples(sensors, stamps_ns, st.integers(0, 4_000 * MS), st.sampled_from([None, 0, 1, 2])))


@given(
    arrivals,
    st.dictionaries(sensors, st.integers(-200 * MS, 200 * MS)),
    st.sampled_from(["header", "log"]),
    st.sampled_from([None, "0:3", "2:"]),
)
def test_time_never_stands_still_within_a_segment(items, offsets, source, frames):
    made = [(cloud(s) if n == "lidar" else scan(s), a, k) for n, s, a, k in items]
    log = FakeLog([replace(m, log_ns=arrival, frame_number=number) for m, arrival, number in made])
    sync, faults = SyncParams(max_gap_ns=500 * MS, max_jump_ns=300 * MS), FaultLog()
    excerpt, stamps = make_excerpt(None, None, frames), StampParams(source, offsets)
    stream = FrameStream(log, sync, stamps, excerpt, Clock(), faults) if usable(log, offsets) else None
    seen: list[tuple[int, int]] = []
    for frame in stream.frames(log) if stream else ():
        if seen and frame.segment == seen[-1][0]:
            assert frame.stamp_ns > seen[-1][1]
        assert not seen or frame.segment >= seen[-1][0]
        seen.append((frame.segment, frame.stamp_ns))


def usable(log, offsets):
    return bool(log.items) and set(offsets) <= set(log.rig.mounts)


def test_progress_counts_the_frames_that_are_done(tmp_path):
    done = []
    play(drive(4), tmp_path / "run", progress=done.append)
    assert done == [1, 2, 3, 4]
