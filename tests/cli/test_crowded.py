"""What is far more than any sensor, labeler or detector gives: refused or thinned by a limit that has a name."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.cli.conftest import messages, rig, truths, write_log

from fbench.replay.data.boxes import MAX_BOXES
from fbench.replay.data.messages import PointCloud, RadarScan
from fbench.reports.preview.sample import MAX_ECHOES, MAX_POINTS, depth_edges

PLUGIN = """
import numpy as np
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.frames import Output


class Crowd:
    num = {num}

    def start(self, rig, log_info):
        place = np.full((self.num, 3), 9.0)
        self.boxes = Boxes3D(place, np.ones((self.num, 3)), np.zeros(self.num), score=np.ones(self.num))

    def reset(self, reason):
        pass

    def step(self, frame):
        return Output(self.boxes, None, {{}})


class FlatCrowd(Crowd):
    def start(self, rig, log_info):
        names, corners = np.full(self.num, "camera"), np.tile([0.0, 0, 9, 9], (self.num, 1))
        self.boxes = Boxes2D(names, corners, score=np.ones(self.num))
"""


@pytest.mark.parametrize("name", ["Crowd", "FlatCrowd"])
def test_boxes_of_a_plugin(fbench, log, name):
    Path("crowd.py").write_text(PLUGIN.format(num=100_000))
    result = fbench("replay", log, "-p", f"crowd.py:{name}", "-o", "run")
    assert result.code == 3
    assert (
        f"Output.detections: 100000 boxes{' in one image' * (name == 'FlatCrowd')}, more than {MAX_BOXES}" in result.err
    )
    assert result.err.count("\n") == 1
    assert not Path("run").exists()
    Path("crowd.py").write_text(PLUGIN.format(num=MAX_BOXES))
    assert fbench("replay", log, "-p", f"crowd.py:{name}", "-o", "run").code == 0


def test_boxes_of_a_program(fbench, log):
    one = {"center_m": [9, 0, 0], "size_lwh_m": [4, 2, 1], "yaw_rad": 0, "score": 1}
    Path("program.py").write_text(
        "import json, sys\n"
        "for line in sys.stdin:\n"
        f"    print(json.dumps({{'detections': [{one!r}] * 100_000}}), flush=True)\n"
    )
    result = fbench("replay", log, "-p", f"exec:{sys.executable} program.py", "-o", "run")
    assert result.code == 3
    assert result.err.count("\n") == 1
    assert not Path("run").exists()


def crowded(change):
    return [change(m) if m.stamp_ns == 1_000_000_000 else m for m in messages()]


def same_place(num):
    return np.tile(np.array([[12.0, 1, 0.5]], np.float32), (num, 1))


@pytest.mark.slow
def test_a_million_points_and_echoes_in_one_place(fbench, tmp_path):
    def change(message):
        if isinstance(message, PointCloud):
            return PointCloud(message.sensor, message.stamp_ns, message.log_ns, same_place(1_000_000))
        if isinstance(message, RadarScan):
            xyz, speed = same_place(1_000_000), np.full(1_000_000, 3.0, np.float32)
            return RadarScan(message.sensor, message.stamp_ns, message.log_ns, xyz, speed)
        return message

    log = write_log(tmp_path / "crowded.mcap", [*crowded(change), *truths()], rig())
    assert fbench("log", "preview", log, "-o", "preview").code == 0
    text = Path("preview/index.html").read_text()
    assert f"lidar has very many points: every {1_000_000 // MAX_POINTS + 1}. is shown" in text
    assert f"radar has very many points: every {1_000_000 // MAX_ECHOES}. is shown" in text
    for pipeline in ("early3d", "late3d", "plain3d"):  # late3d detects in each sensor, as lidar3d and radar3d do
        assert fbench("replay", log, "-p", pipeline, "-o", f"run-{pipeline}", "--report").code == 0
    assert fbench("log", "check", log).code in (0, 1)
    assert fbench("init", log, "-o", "new.toml").code == 0


def test_points_of_one_direction_hide_no_edge():
    near, far = [[5.0, 0, 0]], [[9.0, 0.04, 0]]
    few = np.array(near * 10 + far * 10)
    many = np.array(near * 200_000 + far * 200_000)
    assert len(depth_edges(few)) == 0  # too many equal ones hide each other, whatever their number
    assert len(depth_edges(many)) == 0
    alone = np.array(near * 4 + far * 4 + [[5.0, 3, 0], [5, 4, 0]])
    assert depth_edges(alone).tolist() == [0, 1, 2, 3]


def test_truth_of_a_frame(fbench, tmp_path):
    from tests.cli.test_fault_matrix import truth_crowded

    log = write_log(tmp_path / "log.mcap", truth_crowded([*messages(), *truths()]))
    result = fbench("log", "check", log, "--json")
    assert result.code == 1
    assert "GT008" in result.out
    assert fbench("log", "preview", log, "-o", "preview").code == 0
    assert fbench("replay", log, "-p", "lidar3d", "-o", "run").code == 4
    frames = json.loads(Path("run/scores.json").read_text())
    assert frames
