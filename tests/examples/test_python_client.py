"""The Python client: as a program, and its parts."""

import sys
from contextlib import closing

import numpy as np
import pytest
from tests.examples.conftest import EXAMPLES

from fbench.pipelines.external.pipeline import Exec, ExecParams, RefusedError
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import PointCloud
from fbench.replay.data.rig import LogInfo, Mount, Rig
from fbench.replay.geometry.transforms import pose_matrix

TILTED = np.array([0.1, -0.2, 0.3, 0.9]) / np.linalg.norm([0.1, -0.2, 0.3, 0.9])
RIG = Rig({"lidar": Mount("lidar", np.array([1.0, 0, 2]), TILTED)}, {})
INFO = LogInfo("drive", "drive-1")


def program(tmp_path, body):
    path = tmp_path / "stack.py"
    head = f"import sys; sys.path.insert(0, {str(EXAMPLES / 'python')!r})\nfrom client import run, schema\n"
    path.write_text(head + body)
    return Exec(ExecParams(f"{sys.executable} {path}"))


def test_nearest_point_in_body_coordinates():
    sensor_xyz = np.array([[30.0, 1, 1], [6, -4, 1], [8, 0, 2]], np.float32)
    with closing(Exec(ExecParams(f"{sys.executable} {EXAMPLES}/python/nearest.py 3"))) as pipeline:
        pipeline.start(RIG, INFO)
        pipeline.reset("gap")
        output = pipeline.step(Frame(0, 1, 0, {"lidar": PointCloud("lidar", 1, 1, sensor_xyz)}))
        nothing = pipeline.step(Frame(1, 2, 0, {}, {"lidar": "never came"}))
    pose = pose_matrix(np.array([1.0, 0, 2]), TILTED)
    body = sensor_xyz.astype(float) @ pose[:3, :3].T + pose[:3, 3]
    kept = body[(np.hypot(body[:, 0], body[:, 1]) > 3) & (body[:, 2] > 0.3)]
    wanted = kept[np.argmin(np.hypot(kept[:, 0], kept[:, 1]))]
    np.testing.assert_allclose(output.tracks.center_m, wanted[None], rtol=1e-12)
    assert output.tracks.track_id.tolist() == [1]
    assert list(output.stage_ns) == ["detect.lidar"]
    assert len(nothing.detections) == 0
    assert pipeline.stderr() == b"reset: gap\n"


def test_prints_and_reads_of_a_stack_do_no_harm(tmp_path):
    body = """
import os
class Stack:
    name = "stack"
    def start(self, hello): print("printed"); os.system("echo from a shell"); self.read = sys.stdin.read()
    def reset(self, reason): pass
    def step(self, frame):
        os.write(1, b"written to 1\\n")
        if frame.index == 1: raise ValueError("frame is dark")
        output = schema.Output()
        output.in_2d.SetInParent()
        return output
run(Stack())
"""
    with closing(program(tmp_path, body)) as pipeline:
        pipeline.start(RIG, INFO)
        assert len(pipeline.step(Frame(0, 1, 0, {})).detections) == 0
        with pytest.raises(RefusedError, match=r"python.* says: ValueError: frame is dark"):
            pipeline.step(Frame(1, 2, 0, {}))
        pipeline.step(Frame(2, 3, 0, {}))
    assert sorted(pipeline.stderr().splitlines()) == sorted([b"printed", b"from a shell", *[b"written to 1"] * 3])


def test_stack_that_cannot_start(tmp_path):
    body = """
class Stack:
    name = "stack"
    def start(self, hello): raise RuntimeError(f"no camera in {hello.log_name}")
run(Stack())
"""
    pipeline = program(tmp_path, body)
    with closing(pipeline), pytest.raises(LogError, match="says: RuntimeError: no camera in drive"):
        pipeline.start(RIG, INFO)


def test_columns_are_views(importable):
    from fbench.pipelines.external import fbench_exec_pb2 as schema

    client = importable("client")
    xyz = np.arange(6, dtype=np.float32).reshape(2, 3)
    cloud = schema.PointCloud(xyz=xyz.tobytes(), ring=np.array([3, 4], "<u2").tobytes(), intensity=b"")
    got = client.columns(cloud)
    assert list(got) == ["xyz", "intensity", "ring"]
    np.testing.assert_array_equal(got["xyz"], xyz)
    assert got["ring"].tolist() == [3, 4]
    assert client.columns(schema.PointCloud())["xyz"].shape == (0, 3)
