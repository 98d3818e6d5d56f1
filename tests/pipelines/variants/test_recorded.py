"""Results that another system wrote, found for the frames that they belong to."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.pipelines.frames import rig

from fbench.pipelines.sensors.recorded import HELD
from fbench.pipelines.variants.recorded import Recorded, RecordedParams
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import PointCloud, Pose, Truth
from fbench.replay.data.rig import LogInfo

MS = 1_000_000
S = 1000 * MS
INFO = LogInfo("log", "id")
RIG = rig("lidar", "cam")


class Log:
    """Implements `BoxReader`."""

    def __init__(self, results, poses=()):
        self._results, self._poses = results, poses
        self.poses = tuple(sorted({pose.sensor for pose in poses}))

    def body_poses(self):
        yield from self._poses

    def detections(self, topic):
        if topic not in ("", "/tracks"):
            raise LogError(f"no topic '{topic}'")
        yield from self._results


def box(x, n=1, **more):
    return Boxes3D(np.full((n, 3), [x, 0.0, 0.0]), np.ones((n, 3)), np.zeros(n), **more)


def result(ms, x=None, delay_ms=70, **more):
    return Truth(S + ms * MS, S + (ms + delay_ms) * MS, box(ms if x is None else x), **more)


def pose_at(ms, x, y=0.0, delay_ms=2):
    """Looking along y of the world."""
    turned = np.array([0.0, 0, 2**-0.5, 2**-0.5])
    return Pose("pose", S + ms * MS, S + (ms + delay_ms) * MS, np.array([x, y, 0.0]), turned)


def frame(index, ms, segment=0, delay_ms=1, **more):
    stamp = S + ms * MS
    messages: dict[str, Any] = {
        "lidar": PointCloud("lidar", stamp, stamp + delay_ms * MS, np.zeros((1, 3), np.float32))
    }
    return Frame(index, stamp, segment, messages, **more)


def started(results, poses=(), **params):
    pipeline = Recorded(RecordedParams(topic="/tracks", **params))
    pipeline.use_log(Log(results, poses))
    pipeline.start(RIG, INFO)
    pipeline.reset("start")
    return pipeline


def test_results_of_dropped_frames_belong_to_frames():
    pipeline = started([result(0, 1), result(100, 2), result(200, 3)])
    pipeline.step(frame(0, 0))
    pipeline.skip(frame(1, 100))
    output = pipeline.step(frame(2, 200))
    assert (output.faults, len(output.detections)) == ((), 1)


def places(outputs):
    """The x of each frame's only box, `None` where there is none."""
    return [float(o.detections.center_m[0, 0]) if len(o.detections) else None for o in outputs]


def run(results, stamps_ms, **params):
    pipeline = started(results, **params)
    return [pipeline.step(frame(i, ms)) for i, ms in enumerate(stamps_ms)]


def test_each_frame_gets_the_result_of_its_stamp():
    outputs = run([result(ms) for ms in (0, 100, 200)], [0, 100, 200])
    assert places(outputs) == [0, 100, 200]
    assert [(o.clock, dict(o.stage_ns)) for o in outputs] == [("log", {"recorded": 70 * MS})] * 3
    assert not any(o.faults or o.missing for o in outputs)


def test_frames_without_a_result():
    outputs = run([result(0), result(300)], [0, 100, 200, 300])
    assert places(outputs) == [0, None, None, 300]
    assert dict(outputs[1].missing) == {"/tracks": "no output within 50 ms"}
    assert (outputs[1].clock, dict(outputs[1].stage_ns)) == ("log", {})
    assert isinstance(outputs[1].tracks, Boxes3D)


@pytest.mark.parametrize(("away", "found"), [(50, True), (51, False), (-50, True), (-51, False)])
def test_tolerance(away, found):
    outputs = run([result(1000 + away)], [1000])
    assert (places(outputs) != [None]) == found


def test_offset_of_the_results():
    assert places(run([result(80), result(180)], [0, 100], offset_ms=80)) == [80, 180]
    assert places(run([result(80), result(180)], [0, 100])) == [None, 80]  # which is how it looks without


def test_a_result_belongs_to_the_nearest_frame_alone():
    """Frames at 20 Hz, results at 10 Hz: every second frame has none, though one is within the tolerance."""
    outputs = run([result(ms) for ms in range(0, 500, 100)], range(0, 500, 50))
    assert places(outputs)[2:] == [100, None, 200, None, 300, None, 400, None]


def test_results_that_no_frame_takes_are_counted():
    outputs = run([result(ms) for ms in range(0, 210, 10)], [0, 100, 200])
    assert places(outputs) == [0, 100, 200]
    assert [[f.code for f in o.faults] for o in outputs] == [[], ["PRD003"] * 9, ["PRD003"] * 9]
    assert outputs[1].faults[0].where == "/tracks before frame 1"


def test_results_before_their_frame_have_no_latency():
    [output] = run([result(20, delay_ms=-30)], [0])
    assert places([output]) == [20]
    assert (output.clock, dict(output.stage_ns)) == ("log", {})
    assert [(f.code, f.where) for f in output.faults] == [("PRD004", "/tracks: 10.000 ms")]


def test_results_whose_time_of_recording_isnt_known():
    [output] = run([result(10, delay_ms=0)], [0])
    assert (output.clock, dict(output.stage_ns), output.faults) == ("log", {}, ())


def test_clock_that_jumps_back():
    """What is left of the time before the jump is no hindrance."""
    ahead = [result(ms) for ms in range(60_000, 62_000, 100)]
    back = [result(ms) for ms in range(0, 2000, 100)]
    pipeline = started([*ahead, *back])
    outputs = [pipeline.step(frame(i, 60_000 + 100 * i)) for i in range(18)]
    pipeline.reset("clock jumped back")
    outputs += [pipeline.step(frame(18 + i, 100 * i, 1)) for i in range(20)]
    assert places(outputs) == [*range(60_000, 61_800, 100), *range(0, 2000, 100)]


def test_first_frame_after_a_jump_back_may_lack_a_result():
    results = [*(result(ms) for ms in range(60_000, 61_000, 100)), *(result(ms) for ms in range(300, 1000, 100))]
    pipeline = started(results)
    for i in range(10):
        pipeline.step(frame(i, 60_000 + 100 * i))
    pipeline.reset("clock jumped back")
    outputs = [pipeline.step(frame(10 + i, 100 * i, 1)) for i in range(5)]
    assert places(outputs) == [None, None, None, 300, 400]


def test_a_recording_in_a_loop_repeats_its_stamps():
    second = [replace(result(ms, x=-1 - ms), log_ns=S + (5000 + ms) * MS) for ms in range(0, 500, 100)]
    pipeline = started([*(result(ms) for ms in range(0, 500, 100)), *second])
    first = [pipeline.step(frame(i, 100 * i)) for i in range(5)]
    pipeline.reset("clock jumped back")
    late = [frame(5 + i, 100 * i, 1) for i in range(5)]
    late = [replace(f, messages={"lidar": replace(f.messages["lidar"], log_ns=f.stamp_ns + 5 * S)}) for f in late]
    assert places([*first, *(pipeline.step(f) for f in late)]) == [0, 100, 200, 300, 400, -1, -101, -201, -301, -401]


def test_the_same_frame_again_after_a_reset():
    pipeline = started([result(0), result(100)])
    first = pipeline.step(frame(0, 0))
    pipeline.reset("check")
    assert places([pipeline.step(frame(0, 0))]) == places([first]) == [0]


def test_results_of_an_excerpt_are_found_behind_many():
    results = [result(ms) for ms in range(0, 100 * HELD * 3, 100)]
    outputs = run(results, [100 * HELD * 2, 100 * HELD * 2 + 100])
    assert places(outputs) == [100 * HELD * 2, 100 * HELD * 2 + 100]
    assert not outputs[0].faults


def test_little_is_read_ahead():
    num_read = 0

    def counted():
        nonlocal num_read
        for ms in range(0, 1_000_000, 100):
            num_read += 1
            yield result(ms)

    pipeline = started(counted())
    pipeline.step(frame(0, 0))
    assert num_read < 20


def test_results_that_count_frames():
    results = [Truth(0, 0, box(i), frame_index=i) for i in (0, 1, 5)]
    pipeline = started(results)
    outputs = [pipeline.step(frame(i, 37 * i)) for i in (0, 1, 2, 5)]
    assert places(outputs) == [0, 1, None, 5]
    assert not any(o.stage_ns for o in outputs)


def test_sparse_results_that_count_frames_stay_held():
    results = [Truth(0, 0, box(i), frame_index=i) for i in range(0, 20_000, 20)]
    pipeline = started(results)
    outputs = [pipeline.step(frame(i, 100 * i)) for i in range(6000)]
    assert [p for p in places(outputs) if p is not None] == list(range(0, 6000, 20))


def test_numbers_of_the_log_go_before_indices():
    results = [Truth(0, 0, box(i), frame_index=i, frame_number=i) for i in (7, 8)]
    pipeline = started(results)
    outputs = [pipeline.step(frame(i, 100 * i, frame_number=i + 7)) for i in (0, 1)]
    assert places(outputs) == [7, 8]


def test_boxes_with_ids_are_tracks():
    [output] = run([Truth(S, S + 1, box(3, track_id=np.array([9])))], [0])
    assert output.detections is output.tracks
    assert output.tracks.track_id.tolist() == [9]


def flat(*cameras):
    return Boxes2D(np.array(cameras, np.str_), np.full((len(cameras), 4), [0.0, 1, 2, 3]))


def test_images_and_cameras_that_arent_there():
    pipeline = started(
        [Truth(S, S + 1, None, flat()), Truth(S + 100 * MS, S + 100 * MS + 1, None, flat("cam", "rear"))]
    )
    first, second = pipeline.step(frame(0, 0)), pipeline.step(frame(1, 100))
    assert isinstance(first.detections, Boxes2D)
    assert second.detections.camera.tolist() == ["cam"]
    assert dict(second.missing) == {"/tracks in rear": "isn't among the cameras of the run"}


def test_boxes_of_several_cameras_at_one_instant_are_joined():
    results = [Truth(S, S + i, None, flat(name)) for i, name in ((1, "cam"), (2, "other"))]
    pipeline = started(results)
    output = pipeline.step(frame(0, 0))
    assert output.detections.camera.tolist() == ["cam"]
    assert list(output.missing) == ["/tracks in other"]


def test_kind_of_boxes_that_comes_later():
    """Empty results before the first boxes are of their kind."""
    empty = Truth(S, S + 1, Boxes3D.empty(), Boxes2D.empty())
    pipeline = started([empty, Truth(S + 100 * MS, S + 100 * MS + 1, None, flat("cam"))])
    assert isinstance(pipeline.step(frame(0, 0)).detections, Boxes2D)
    [only] = run([Truth(S, S + 1, Boxes3D.empty())], [0])
    assert isinstance(only.detections, Boxes3D)
    assert (len(only.detections), dict(only.missing)) == (0, {})


def test_boxes_in_the_world_need_poses():
    # The body stands at (10, 20) and looks along y of the world: what is 5 m north of it is 5 m ahead.
    seen = Truth(
        S, S + 70 * MS, Boxes3D(np.array([[10.0, 25, 1]]), np.ones((1, 3)), np.array([np.pi / 2])), in_world=True
    )
    pipeline = started([seen, replace(seen, stamp_ns=S + 100 * MS)], [pose_at(0, 10.0, 20.0)])
    output, without = pipeline.step(frame(0, 0)), pipeline.step(frame(1, 100))
    np.testing.assert_allclose(output.detections.center_m, [[5, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(output.detections.yaw_rad, [0], atol=1e-12)
    assert dict(without.missing) == {"/tracks": "no pose that moves it from the world to the body"}
    with pytest.raises(
        LogError, match="log 'log': the boxes of '/tracks' are in coordinates of the world, and the log"
    ):
        started([seen])


def test_boxes_in_the_world_are_seen_from_where_the_body_is_at_the_instant_of_the_frame():
    """15 m/s along y, poses at 10 Hz in the middle between frames: none comes before its frame is complete."""
    steps = range(0, 500, 100)
    poses = [pose_at(ms, 0.0, 0.015 * ms) for ms in range(-50, 600, 100)]
    results = [Truth(S + ms * MS, S + (ms + 70) * MS, standing(), in_world=True) for ms in steps]
    pipeline = started(results, poses)
    ahead = [pipeline.step(frame(i, ms)).detections.center_m[0] for i, ms in enumerate(steps)]
    np.testing.assert_allclose(ahead, [[40 - 0.015 * ms, 0, 0] for ms in steps], atol=1e-9)


def test_boxes_in_the_world_after_a_clock_that_jumps_back():
    """Poses of the time before the jump, and those that arrive before their frame, don't get in the way."""
    ahead = range(9000, 9500, 100)
    poses = [pose_at(ms, 0.0, 0.01 * ms) for ms in range(8900, 9500, 50)]
    poses += [replace(pose_at(ms, 0.0, 0.02 * ms), log_ns=S + (10_000 + ms) * MS) for ms in range(-100, 600, 50)]
    results = [Truth(S + ms * MS, S + (ms + 70) * MS, standing(), in_world=True) for ms in ahead]
    results += [Truth(S + ms * MS, S + (10_070 + ms) * MS, standing(), in_world=True) for ms in range(0, 500, 100)]
    pipeline = started(results, poses)
    before = places([pipeline.step(frame(i, ms)) for i, ms in enumerate(ahead)])
    pipeline.reset("clock jumped back")
    found = places([pipeline.step(frame(5 + i, ms, 1, delay_ms=10_100)) for i, ms in enumerate(range(0, 500, 100))])
    np.testing.assert_allclose(before, [40 - 0.01 * ms for ms in ahead])
    np.testing.assert_allclose(found, [40 - 0.02 * ms for ms in range(0, 500, 100)])


def standing():
    """Stands 40 m along y of the world, and looks there."""
    return Boxes3D(np.array([[0.0, 40, 0]]), np.ones((1, 3)), np.array([np.pi / 2]))


def test_what_cannot_be_used():
    with pytest.raises(LogError, match="log 'log': '/tracks' holds no result that can be used"):
        started([])
    with pytest.raises(ConfigError, match="reads results from a log, and got none"):
        Recorded().start(RIG, INFO)
    with pytest.raises(ConfigError, match="tolerance_ms: expected at least 0, got -1"):
        RecordedParams(tolerance_ms=-1.0)


def test_another_rig_within_the_log_goes_on():
    pipeline = started([result(ms) for ms in (0, 100)])
    first = pipeline.step(frame(0, 0))
    pipeline.start(RIG, INFO)
    pipeline.reset("calibration of lidar changes")
    assert places([first, pipeline.step(frame(1, 100, 1))]) == [0, 100]


@settings(deadline=None)
@given(
    st.lists(st.integers(80, 120), min_size=1, max_size=40),
    st.lists(st.integers(-20, 20), min_size=40, max_size=40),
    st.lists(st.booleans(), min_size=40, max_size=40),
)
def test_nearest_within_the_tolerance(gaps, jitter, present):
    """Wherever frames and results are far less apart than frames, the nearest is found, as one who sees all would."""
    stamps = np.cumsum([0, *gaps]).tolist()
    kept = [i for i in range(len(stamps)) if present[i % 40]]
    results = [result(stamps[i] + jitter[i % 40], x=i) for i in kept]
    if results:
        expected = [float(i) if i in kept else None for i in range(len(stamps))]
        assert places(run(results, stamps, tolerance_ms=25.0)) == expected
