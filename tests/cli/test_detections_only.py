"""Pipelines of others that detect and don't track: no scores of tracks, and a reason."""

import sys
from pathlib import Path

import pytest

CLIENT = Path(__file__).resolve().parents[2] / "examples/exec/python"
PLUGIN = """
import numpy as np
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

class Detector:
    def start(self, rig, log_info): pass
    def reset(self, reason): pass
    def step(self, frame):
        boxes = Boxes3D(np.array([[12.0 + frame.index, 0, 0.75]]), np.array([[4, 1.8, 1.5]]), np.zeros(1))
        return Output(boxes, {tracks}, {{}})
"""
PROGRAM = """
import sys
sys.path.insert(0, {client!r})
from client import run, schema

class Detector:
    name = "detector"
    def start(self, hello): pass
    def reset(self, reason): pass
    def step(self, frame):
        output = schema.Output()
        found = output.in_3d.detections
        found.center_m.extend([12.0 + frame.index, 0, 0.75])
        found.size_lwh_m.extend([4, 1.8, 1.5])
        found.yaw_rad.append(0)
        {tracks}
        return output

run(Detector())
"""
REASON = "the pipeline gave no tracks"


def pipelines(folder, tracks, program):
    (folder / "detector.py").write_text(PLUGIN.format(tracks=tracks))
    (folder / "program.py").write_text(PROGRAM.format(client=str(CLIENT), tracks=program))
    return {"detector.py:Detector": "plugin", f"exec:{sys.executable} program.py": "program"}


@pytest.mark.parametrize(
    ("tracks", "program"),
    [("None", "pass"), ("Boxes3D.empty()", "output.in_3d.tracks.SetInParent()")],
    ids=["not said", "empty"],
)
def test_mota_is_null_with_a_reason(fbench, log, tmp_path, tracks, program):
    for pipeline, out in pipelines(tmp_path, tracks, program).items():
        result = fbench("replay", log, "-p", pipeline, "-o", out, "--report", "--json")
        assert result.code == 0, result.err
        rows = {row["metric"]: row for row in result.json()["scores"] if row["slice"] == "all"}
        assert rows["f1"]["value"] == 1.0
        for metric in ("mota", "idf1", "hota", "idsw", "motp", "mt"):
            assert (rows[metric]["value"], rows[metric]["reason"]) == (None, REASON)
        assert REASON in (tmp_path / out / "report.html").read_text()
        refused = fbench("score", out, "--profile", "nuscenes-tracking")
        assert (refused.code, refused.err) == (3, f"fbench: {out}: {REASON}, which nuscenes-tracking judges\n")
        assert fbench("score", out).code == 0


def test_a_tracker_that_finds_nothing_has_its_mota(fbench, log, tmp_path):
    result = fbench("replay", log, "-p", "lidar3d", "--set", "lidar.max_range_m=3", "-o", "run", "--json")
    mota = next(row for row in result.json()["scores"] if row["metric"] == "mota")
    assert (mota["value"], result.json()["manifest"]["has_tracks"]) == (0.0, True)
