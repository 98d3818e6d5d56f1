"""The C++ header and its example programs, compiled and run."""

import os
import signal
import time
from contextlib import closing

import numpy as np
import pytest

from fbench.pipelines.external.pipeline import Exec, ExecParams
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan
from fbench.replay.data.rig import LogInfo, Mount, Rig
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan
from fbench.replay.logs.open import open_log
from fbench.replay.runs.folder import Run

UPRIGHT = np.array([0, 0, 0, 1.0])
RIG = Rig({"lidar": Mount("lidar", np.array([0, 0, 2.0]), UPRIGHT)}, {})
INFO = LogInfo("drive", "drive-1", {"place": "here"})


def replayed(log, folder, command):
    faults = FaultLog()
    with closing(Exec(ExecParams(str(command)))) as pipeline:
        replay(open_log(log, faults), Plan(pipeline, "exec"), folder, faults)
    return Run(folder)


@pytest.mark.slow
def test_clusters_are_where_the_vehicles_are(cpp, boxes, tmp_path):
    from fbench.metrics.runs.detection import Detection
    from fbench.replay.data.scores import ScoreOptions

    run = replayed(boxes, tmp_path / "a", cpp / "lidar_clusters")
    f1 = Detection().scores(run, ScoreOptions())[0]
    assert f1.metric == "f1"
    assert f1.value > 0.35  # 0.48 when this was written
    again = replayed(boxes, tmp_path / "b", cpp / "lidar_clusters")
    assert run.manifest.digest == again.manifest.digest


def test_order_of_points_doesnt_matter_to_clusters(cpp):
    rng = np.random.Generator(np.random.Philox(key=1))
    xyz = np.concatenate([rng.uniform([8, -1, -1.5], [8.2, 1, -0.5], (200, 3)), rng.uniform(-40, 40, (2000, 3))])
    shuffled = rng.permutation(xyz)
    with closing(Exec(ExecParams(f"{cpp}/lidar_clusters"))) as pipeline:
        pipeline.start(RIG, INFO)
        a, b = (
            pipeline.step(Frame(0, 1, 0, {"lidar": PointCloud("lidar", 1, 1, points.astype(np.float32))}))
            for points in (xyz, shuffled)
        )
    assert len(a.detections) > 0
    for name, array in a.detections.arrays().items():
        np.testing.assert_array_equal(array, b.detections.arrays()[name])
    assert list(a.stage_ns) == ["preprocess", "detect.lidar"]


def test_log_without_lidar_is_refused_by_the_program(cpp):
    pipeline = Exec(ExecParams(f"{cpp}/lidar_clusters"))
    with closing(pipeline), pytest.raises(LogError, match=r"lidar_clusters says: the log has no LiDAR"):
        pipeline.start(Rig({}, {}), INFO)


def checksum(array, bits):
    values = np.ascontiguousarray(array).ravel().view(bits).astype(np.uint64)
    return str(int((values * np.arange(1, len(values) + 1, dtype=np.uint64)).sum(dtype=np.uint64)))


def columns(message, *names):
    arrays = [getattr(message, name) for name in names]
    return " ".join("-" if a is None else checksum(a, f"u{a.dtype.itemsize}") for a in arrays)


def described(m):
    head = f"{m.stamp_ns} {m.log_ns}"
    if isinstance(m, PointCloud):
        return f"{head} points {columns(m, 'xyz', 'intensity', 'ring', 'offset_ns')}"
    if isinstance(m, RadarScan):
        fields = ("xyz", "radial_velocity_mps", "rcs_dbsm", "range_m", "azimuth_rad", "altitude_rad")
        return f"{head} radar {columns(m, *fields)}"
    if isinstance(m, Image):
        size = "x".join(map(str, m.size_wh))
        return f"{head} image {m.encoding} {size} {checksum(np.frombuffer(m.data, np.uint8), 'u1')}"
    numbers = [format(v, ".17g") for v in (*m.translation_m, *m.rotation_xyzw)]
    return f"{head} pose {' '.join(numbers)}"


def test_program_sees_the_same_numbers(cpp):
    rng = np.random.Generator(np.random.Philox(key=2))

    def f4(*shape):
        return rng.normal(size=shape).astype(np.float32)

    ring, offset = rng.integers(0, 65536, 777).astype("u2"), rng.integers(-(2**31), 2**31, 777).astype("i4")
    messages: list[Message] = [
        PointCloud("full", 2**62, 5, f4(777, 3), f4(777), ring, offset),
        PointCloud("bare", 0, 1, f4(50_000, 3)),
        PointCloud("empty", 1, 2, f4(0, 3), f4(0)),
        RadarScan("radar", 3, 4, f4(9, 3), *(f4(9) for _ in range(5))),
        RadarScan("plain", 3, 4, f4(9, 3), None, f4(9)),
        Image("cam", 5, 6, rng.bytes(1001), "jpeg", (641, 480)),
        Pose("pose", 7, 8, np.array([1e6, 0.1, -3]), np.array([0.5, -0.5, 0.5, 0.5])),
    ]
    with closing(Exec(ExecParams(f"{cpp}/echo --checksum"))) as pipeline:
        pipeline.start(RIG, INFO)
        output = pipeline.step(Frame(3, 2**62, 1, {m.sensor: m for m in messages}, {"gone": "never came"}, -5))
        assert pipeline.stderr() == b""  # stdio keeps it, and it isn't in the answer
    assert pipeline.stderr() == b"drive: 1 sensors\n"
    assert output.missing == {m.sensor: described(m) for m in messages}
    first = np.stack([m.xyz[0] for m in (messages[1], messages[0]) if isinstance(m, PointCloud)]).astype(np.float64)
    np.testing.assert_array_equal(output.detections.center_m, first)


@pytest.mark.parametrize(("number", "name"), [(signal.SIGKILL, "SIGKILL"), (signal.SIGSTOP, "")])
def test_program_that_is_hit_from_outside(cpp, number, name):
    def step(i):
        return pipeline.step(Frame(i, i, 0, {"lidar": PointCloud("lidar", i, i, np.ones((1, 3), np.float32))}))

    with closing(Exec(ExecParams(f"{cpp}/echo", frame_timeout_s=0.5))) as pipeline:
        pipeline.start(RIG, INFO)
        step(0)
        os.kill(child_of_mine("echo"), number)
        time.sleep(0.1)
        match = r"exited with 137 \(SIGKILL\)" if name else "within 0.5 s"
        with pytest.raises(Exception, match=match):
            step(1)
        assert len(step(2).detections) == 1


def child_of_mine(name):
    for entry in os.listdir("/proc"):
        try:
            with open(f"/proc/{entry}/stat") as file:
                text = file.read()
        except OSError:
            continue
        rest = text.rpartition(")")[2].split()
        if f"({name})" in text and int(rest[1]) == os.getpid():
            return int(entry)
    raise AssertionError(f"no child called {name}")
