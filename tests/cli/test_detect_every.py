"""`--detect-every`, as a user calls it."""

import json
from pathlib import Path

import pytest

MINE = """
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

class Mine:
    def start(self, rig, log_info): pass
    def reset(self, reason): pass
    def step(self, frame): return Output(Boxes3D.empty(), Boxes3D.empty(), {})
"""


def test_it_is_a_parameter_and_the_run_says_so(fbench, log):
    shown = fbench("replay", log, "-p", "lidar3d", "--detect-every", "3", "-o", "a")
    assert shown.code == 0
    assert "predicted: 4 of 6 detections, as detection ran in one frame of 3; scores count them" in shown.out
    by_name = fbench("replay", log, "-p", "lidar3d", "--set", "detect_every=3", "-o", "b", "--json").json()
    assert by_name["manifest"]["parameters"]["detect_every"] == 3
    assert (Path("a") / "manifest.json").read_bytes() == (Path("b") / "manifest.json").read_bytes()
    rows = {row["metric"]: row for row in json.loads(Path("a/scores.json").read_text())[:3]}
    assert {name: row["counts"]["predicted"] for name, row in rows.items()} == {"f1": 4, "precision": 4, "recall": 4}


def test_without_it_nothing_is_said(fbench, log):
    shown = fbench("replay", log, "-p", "lidar3d", "-o", "a", "--detect-every", "1")
    assert shown.code == 0
    assert "predicted" not in shown.out
    assert "predicted" not in Path("a/scores.json").read_text()


def test_a_report_says_so(fbench, log):
    fbench("replay", log, "-p", "lidar3d", "--detect-every", "2", "-o", "a", "--no-media", "--report")
    text = Path("a/report.html").read_text()
    assert "Tracks predicted in between stand for detections." in text
    assert "3 of 6 detections, as detection ran in one frame of 2; scores count them" in text


@pytest.mark.parametrize("command", ["replay", "verify"])
@pytest.mark.parametrize("pipeline", ["recorded", "exec:true", "mine.py:Mine"])
def test_a_pipeline_that_has_no_such_parameter_is_refused(fbench, log, in_this_process, command, pipeline):
    in_this_process()
    Path("mine.py").write_text(MINE)
    refused = fbench(command, log, "-p", pipeline, "--detect-every", "2")
    assert refused.code == 2
    name = f"--detect-every 2: pipeline '{pipeline}' has no parameter detect_every; it decides itself when it detects"
    assert refused.err.strip().endswith(name)
    assert not Path("runs").exists()


@pytest.mark.parametrize("value", ["0", "-1", "two", "1.5"])
def test_what_is_no_number_of_frames_is_refused(fbench, log, value):
    assert fbench("replay", log, "-p", "lidar3d", "--detect-every", value).code == 2


def test_an_unknown_pipeline_is_named(fbench, log):
    refused = fbench("replay", log, "-p", "lidar4d", "--detect-every", "2")
    assert (refused.code, "did you mean 'lidar3d'" in refused.err) == (2, True)


@pytest.mark.slow
def test_verify_takes_it(fbench, log, circumstances, in_this_process):
    circumstances("2 threads")
    in_this_process()
    assert fbench("verify", log, "-p", "late3d", "--detect-every", "2", "--quick").code == 0
