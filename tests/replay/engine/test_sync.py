"""The frame buffer: the thesis's worked example, nearest stamps, segments."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.replay.fakes import Echo, FakeLog

from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import PointCloud
from fbench.replay.data.rig import LogInfo, Mount, Rig
from fbench.replay.engine.frame_buffer import FrameBuffer, SyncParams, choose_reference, make_sync_params
from fbench.replay.engine.loop import replay as play_log
from fbench.replay.engine.plan import Plan
from fbench.replay.runs.folder import Run

MS = 1_000_000
SENSORS = ("camera", "lidar", "radar")


def message(sensor, stamp_ms, arrival_ms=None, number=None):
    arrival = stamp_ms if arrival_ms is None else arrival_ms
    return PointCloud(
        sensor, round(stamp_ms * MS), round(arrival * MS), np.zeros((0, 3), np.float32), frame_number=number
    )


def play(messages, expected=SENSORS, reference="camera", **params):
    buffer = FrameBuffer(expected, reference, SyncParams(**params))
    frames = []
    for m in sorted(messages, key=lambda m: (m.log_ns, m.sensor)):
        frames += buffer.advance(m.log_ns)
        if m.sensor == reference:
            frames += buffer.open_frame(m)
        frames += buffer.add(m)
    return frames + list(buffer.flush()), buffer


def thesis_frame(number, offsets_ms):
    """Frame `number` at 100 ms intervals; each sensor's arrival after the instant, `None`: never."""
    start = 100 * number
    return [message(s, start, start + o, number) for s, o in offsets_ms.items() if o is not None]


def test_thesis_example_with_frame_numbers():
    log = [
        *thesis_frame(0, {"camera": 5, "lidar": 5, "radar": 5}),  # all on time
        *thesis_frame(1, {"camera": 0, "lidar": 15, "radar": 29}),  # staggered, but in time
        *thesis_frame(2, {"camera": 0, "lidar": 45, "radar": 10}),  # LiDAR 15 ms too late
        *thesis_frame(3, {"camera": 0, "lidar": 5, "radar": None}),  # radar missing
    ]
    frames, buffer = play(log)
    assert [sorted(f.messages) for f in frames] == [
        ["camera", "lidar", "radar"],
        ["camera", "lidar", "radar"],
        ["camera", "radar"],
        ["camera", "lidar"],
    ]
    assert [dict(f.missing) for f in frames[2:]] == [
        {"lidar": "not there within 30 ms"},
        {"radar": "not there within 30 ms"},
    ]
    assert buffer.counts.late_ms == {(2, "lidar"): 15.0}
    assert [f.frame_number for f in frames] == [0, 1, 2, 3]


THESIS = (
    {"camera": 5, "lidar": 5, "radar": 5},  # all on time
    {"camera": 0, "lidar": 15, "radar": 29},  # staggered, but in time
    {"camera": 0, "lidar": 45, "radar": 10},  # LiDAR 15 ms too late
    {"camera": 0, "lidar": 5, "radar": None},  # radar missing
)


@pytest.mark.parametrize("numbered", [True, False])
def test_thesis_example_through_a_replay(tmp_path, numbered):
    messages = [m for i, offsets in enumerate(THESIS) for m in thesis_frame(i, offsets)]
    log = FakeLog(
        [m if numbered else replace(m, frame_number=None) for m in messages],
        rig=rig(camera="camera", lidar="lidar", radar="radar"),
    )
    run = Run(play_log(log, Plan(Echo(), "echo", sync=SyncParams("camera")), tmp_path / "run", FaultLog()))
    assert [(f.stamp_ns // MS, f.frame_number, dict(f.missing)) for f in run.frames] == [
        (0, 0 if numbered else None, {}),
        (100, 1 if numbered else None, {}),
        (200, 2 if numbered else None, {"lidar": "late by 15.0 ms"}),
        (300, 3 if numbered else None, {"radar": "never came"}),
    ]
    faults = run.json("faults.json")
    assert faults["late_messages"] == {"camera": 0, "lidar": 1, "radar": 0}
    assert faults["unused_messages"] == {"camera": 0, "lidar": 0, "radar": 0}


def test_message_at_the_deadline_is_in_time():
    frames, _ = play(thesis_frame(0, {"camera": 0, "lidar": 30, "radar": 0}))
    assert not frames[0].missing


def test_reference_that_comes_late_is_late_with_frame_numbers():
    frames, buffer = play(thesis_frame(0, {"camera": 40, "lidar": 0, "radar": 0}))
    assert list(frames[0].missing) == ["camera"]
    assert buffer.counts.late_ms == {(0, "camera"): 10.0}


def test_faster_sensor_gives_its_nearest_message():
    lidar = [message("lidar", 100 * i, 100 * i + 10) for i in range(10)]
    radar = [message("radar", 50 * i + 10, 50 * i + 15) for i in range(20)]
    frames, buffer = play([*lidar, *radar], ("lidar", "radar"), "lidar")
    joined = [f.messages["radar"].stamp_ns - f.stamp_ns for f in frames[1:]]
    assert joined == [10 * MS] * 9
    assert buffer.counts.unused["radar"] == 20 - len(frames)


def test_message_before_its_frame_opens_waits_for_it():
    frames, _ = play([message("lidar", 95, 95), message("camera", 100, 110)], ("camera", "lidar"))
    assert sorted(frames[0].messages) == ["camera", "lidar"]


def test_stamp_beyond_the_tolerance_stays_out():
    frames, buffer = play([message("camera", 0), message("lidar", 51)], ("camera", "lidar"))
    assert list(frames[0].missing) == ["lidar"]
    assert buffer.counts.unused["lidar"] == 1


def test_gap_and_backward_jump_begin_segments():
    stamps = [0, 100, 200, 2201, 2301, 1000, 1100]
    log = [message("camera", s, 10 * i) for i, s in enumerate(stamps)]
    frames, buffer = play(log, ("camera",))
    assert [f.segment for f in frames] == [0, 0, 0, 1, 1, 2, 2]
    assert buffer.breaks == ["gap of 2.001 s before frame 3", "clock jumps back by 1.301 s before frame 5"]


@pytest.mark.parametrize("numbers", [(None, None), (1, 2)])
def test_first_frame_of_a_segment_gets_what_came_before_its_reference(numbers):
    log = [message(s, t, t, n) for t, n in zip((0, 9000), numbers, strict=True) for s in ("camera", "lidar")]
    frames, buffer = play(log, ("camera", "lidar"), "lidar")
    assert [(f.segment, sorted(f.messages)) for f in frames] == [(0, ["camera", "lidar"]), (1, ["camera", "lidar"])]
    assert buffer.counts.unused == {"camera": 0, "lidar": 0}


def test_gap_of_exactly_the_limit_is_none():
    frames, _ = play([message("camera", 0), message("camera", 2000)], ("camera",))
    assert [f.segment for f in frames] == [0, 0]


def test_reference_out_of_order_or_repeated_opens_no_frame():
    log = [message("camera", s, 10 * i) for i, s in enumerate([0, 100, 60, 100, 200])]
    frames, buffer = play(log, ("camera",))
    assert [f.stamp_ns // MS for f in frames] == [0, 100, 200]
    assert buffer.counts.disordered == 2
    assert buffer.counts.unused == {"camera": 2}


def test_unexpected_sensors_are_left_out():
    frames, _ = play([message("camera", 0), message("sonar", 0)], ("camera",))
    assert list(frames[0].messages) == ["camera"]


def test_extra_messages_of_a_frame_are_unused_not_late():
    radar = [message("radar", 100 * i + 2 * k, 100 * i + 40 + k) for i in range(3) for k in range(3)]
    lidar = [message("lidar", 100 * i, 100 * i + 20) for i in range(3)]
    frames, buffer = play([*lidar, *radar], ("lidar", "radar"), "lidar")
    assert all(len(f.messages) == 2 for f in frames)
    assert buffer.counts.late_ms == {}
    assert buffer.counts.unused["radar"] == 6


def test_frames_of_another_segment_take_no_messages():
    stamps = [0, 100, 200, 300, -1000, -900, -800]
    log = [
        message(s, t, 100 * i + (5 if s == "lidar" else 0)) for i, t in enumerate(stamps) for s in ("radar", "lidar")
    ]
    again = [
        message(s, t, 700 + 100 * i + (5 if s == "lidar" else 0))
        for i, t in enumerate([-700, 0, 100, 200])
        for s in ("radar", "lidar")
    ]
    frames, _ = play([*log, *again], ("lidar", "radar"), "lidar")
    assert len(frames) == 11
    assert all(not f.missing for f in frames)


def test_half_way_between_two_instants_the_nearer_one_wins():
    lidar = [message("lidar", 50 * i, 50 * i + 1) for i in range(20)]
    radar = [message("radar", 50 * i + 27, 50 * i + 28) for i in range(20)]
    frames, _ = play([*lidar, *radar], ("lidar", "radar"), "lidar")
    steps = {f.messages["radar"].stamp_ns - f.stamp_ns for f in frames[3:] if "radar" in f.messages}
    assert steps == {-23 * MS}


def test_jitter_doesnt_leave_a_frame_that_lies_half_way_between_two_messages_without_any():
    """A radar of 15 Hz, whose messages lie 33.3 ms around every other instant of 10 Hz."""
    jitter = np.random.Generator(np.random.Philox(0)).normal(0, 0.6, 300)
    lidar = [message("lidar", 100 * i, 100 * i + 105) for i in range(200)]
    radar = [message("radar", round(i * 200 / 3 + j, 3), i * 200 / 3 + 45) for i, j in enumerate(jitter)]
    frames, _ = play([*lidar, *radar], ("lidar", "radar"), "lidar", tolerance_ns=50 * MS)
    assert sum(bool(f.missing) for f in frames) <= 4  # the mean period isn't known well at first


def test_messages_with_numbers_wait_for_the_frame_of_their_number():
    """Keyframes among sweeps: the image of a keyframe was taken up to a sweep before it."""
    lidar = [message("lidar", 50 * i, number=i // 10 if i % 10 == 0 else None) for i in range(21)]
    camera = [message("camera", s, number=n) for s, n in [(0, 0), (83, None), (445, 1), (528, None), (993, 2)]]
    frames, buffer = play([*lidar, *camera], ("camera", "lidar"), "lidar")
    images = {f.stamp_ns // MS: f.messages["camera"].stamp_ns // MS for f in frames if "camera" in f.messages}
    assert images == {0: 0, 100: 83, 500: 445, 550: 528, 1000: 993}
    assert [f.frame_number for f in frames if f.stamp_ns // MS % 500 == 0] == [0, 1, 2]
    assert buffer.counts.unused == {"camera": 0, "lidar": 0}


def test_a_nearer_sweep_takes_no_keyframe_away():
    """The camera's keyframe is 60 ms before the LiDAR's, a sweep 17 ms behind it, while the radar is waited for."""
    lidar = [message("lidar", 50 * i, number=i // 10 if i % 10 == 0 else None) for i in range(21)]
    camera = [message("camera", s, number=n) for s, n in [(0, 0), (357, None), (440, 1), (517, None), (1000, 2)]]
    radar = [message("radar", s, number=n) for s, n in [(0, 0), (545, 1), (1000, 2)]]
    frames, buffer = play([*lidar, *camera, *radar], reference="lidar", timeout_ns=100 * MS)
    images = {f.stamp_ns // MS: f.messages["camera"].stamp_ns // MS for f in frames if "camera" in f.messages}
    assert images == {0: 0, 350: 357, 500: 440, 1000: 1000}
    assert buffer.counts.unused == {"camera": 1, "lidar": 0, "radar": 0}


def test_the_time_out_of_the_log_counts_unless_one_is_asked_for():
    log = LogInfo("log", "id", {"timeout_ms": "100"})
    assert make_sync_params(None, None, 50, 2).complete_from(log).timeout_ns == 100 * MS
    assert make_sync_params(None, 40, 50, 2).complete_from(log).timeout_ns == 40 * MS
    assert make_sync_params(None, None, 50, 2).complete_from(LogInfo("log", "id")).timeout_ns == 30 * MS
    for text in ("", "-1", "1e3", "nan", "1" * 10, "²"):
        told = make_sync_params(None, None, 50, 2).complete_from(LogInfo("log", "id", {"timeout_ms": text}))
        assert told.timeout_ns == 30 * MS


arrivals = st.lists(st.tuples(st.sampled_from(SENSORS), st.integers(0, 60), st.integers(0, 200)), max_size=60)


@given(arrivals, st.booleans())
def test_no_message_is_lost_or_used_twice(items, numbered):
    log = [message(s, 33 * i, 33 * i + late, i if numbered else None) for s, i, late in items]
    frames, buffer = play(log)
    used = [id(m) for f in frames for m in f.messages.values()]
    assert len(used) == len(set(used))
    counts = buffer.counts
    assert len(used) + sum(counts.unused.values()) + len(counts.late_ms) == len(log)
    assert len(frames) == sum(m.sensor == "camera" for m in log) - counts.disordered
    assert all(a.stamp_ns < b.stamp_ns for a, b in pairwise(frames))
    assert [f.index for f in frames] == list(range(len(frames)))
    assert all(set(f.messages) | set(f.missing) == set(SENSORS) for f in frames)


def rig(**kinds):
    return Rig({name: Mount(kind, np.zeros(3), np.array([0.0, 0, 0, 1])) for name, kind in kinds.items()}, {})


def choose(sensors, num_messages, wanted=None, **metadata):
    return choose_reference(sensors.kinds, LogInfo("log", "id", metadata), num_messages, SyncParams(reference=wanted))


def test_boxes_give_the_instants_where_no_sensor_has_messages():
    full = rig(cam="camera", top="lidar")
    assert choose(full, {"boxes": 7}) == "boxes"
    assert choose(full, {"boxes": 7, "cam": 1}) == "cam"
    assert choose(full, {"boxes": 7}, "top") == "top"


def test_reference_is_chosen_by_option_then_by_the_log():
    full = rig(cam="camera", top="lidar", front="radar")
    counts = {"cam": 10, "top": 10, "front": 20}
    assert choose(full, counts, "cam", reference="front") == "cam"
    assert choose(full, counts, reference="front") == "front"


@pytest.mark.parametrize(
    ("counts", "chosen"),
    [
        ({"cam": 100, "top": 100, "front": 200}, "top"),  # LiDAR first on ties
        ({"cam": 98, "top": 100, "front": 200}, "top"),  # the camera lost two
        ({"cam": 50, "top": 100, "front": 200}, "cam"),
        ({"cam": 100, "front": 100}, "cam"),  # the LiDAR is silent
        ({"cam": 0, "top": 0, "front": 7}, "front"),
    ],
)
def test_reference_is_the_slowest_that_says_something(counts, chosen):
    assert choose(rig(cam="camera", top="lidar", front="radar"), counts) == chosen


def test_unknown_reference_is_a_usage_error():
    with pytest.raises(ConfigError, match=r"reference sensor 'x' isn't in the log; it has: cam"):
        choose(rig(cam="camera"), {"cam": 1}, "x")
    for counts in ({}, {"cam": 0}):
        with pytest.raises(LogError, match="has no messages of a sensor with calibration"):
            choose(rig(cam="camera"), counts)


def test_durations_are_read_and_refused():
    params = make_sync_params("lidar", 20, 0.5, float("inf"))
    assert params == SyncParams("lidar", 20 * MS, MS // 2, 10**18)
    for arguments, option in (((float("nan"), 0, 0), "timeout-ms nan"), ((0, -1, 0), "tolerance-ms -1")):
        with pytest.raises(ConfigError, match=f"--{option}: expected a duration, such as 20"):
            make_sync_params(None, *arguments)
