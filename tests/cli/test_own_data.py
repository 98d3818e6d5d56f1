"""Logs of others through init, preview, replay and score, with the written file untouched."""

import json
import runpy
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from tests.city_log import write_city_log

from fbench.datasets.astyx import Astyx
from fbench.datasets.importing.run import import_one
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.rig import RigChange
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.open import open_log

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "ros2_log.py"


def rewritten(log: Path, out: Path, **options) -> Path:
    """The same as a ROS 2 recorder would have written it: CDR, other topics, two radars, TF, vision_msgs."""
    out.parent.mkdir()
    runpy.run_path(str(EXAMPLE))["rewrite"](log, out, **options)
    return out


def without_ignored(log: Path, out: Path) -> Path:
    """The same log, in which no box is ignored: vision_msgs can't say which ones are."""
    reader = open_log(log, FaultLog())
    with McapWriter(out, reader.info, reader.rig) as writer:
        for message in reader.messages():
            if not isinstance(message, RigChange):
                writer.write(message)
        for truth in reader.truths():
            writer.write(replace(truth, boxes3d=replace(truth.boxes3d, ignore=None)))
    return out


def score(run: Path, metric: str = "f1"):
    rows = json.loads((run / "scores.json").read_text())
    return next(row["value"] for row in rows if row["metric"] == metric)


def quarter_of_an_hour(fbench, log: Path, pipeline: str, preview_args=()) -> Path:
    """What a new user does."""
    for args in (("init", log), ("log", "preview", log, "-o", "preview", *preview_args)):
        assert fbench(*args).code == 0, args
    assert (Path("preview") / "index.html").is_file()
    result = fbench("replay", log, "-p", pipeline, "-o", f"run-{log.stem}-{pipeline}")
    assert result.code == 0, result.err
    return Path(f"run-{log.stem}-{pipeline}")


@pytest.mark.slow
def test_a_rewritten_log_gives_the_numbers_of_the_original(fbench, tmp_path):
    write_city_log(tmp_path / "city.mcap", seconds=2.0)
    own = without_ignored(tmp_path / "city.mcap", tmp_path / "own.mcap")
    # Nothing in it tells that it was simulated, so that model and rules judge it.
    assert fbench("replay", own, "-p", "lidar3d", "--set", "lidar.judge=both", "-o", "base").code == 0
    log = rewritten(own, tmp_path / "ros" / "drive.mcap", results=Path("base"), delay_ms=80.0)
    run = quarter_of_an_hour(fbench, log, "lidar3d", ("--num", 1))
    assert fbench("score", run).code == 0
    assert [score(run, m) for m in ("f1", "precision", "recall")] == [
        score(Path("base"), m) for m in ("f1", "precision", "recall")
    ]
    recorded = fbench("replay", log, "-p", "recorded", "--json", "-o", "recorded")
    assert recorded.code == 0
    latency = recorded.json()["latency"]
    assert latency["clock"] == "log"
    assert [stage["p50_ms"] for stage in latency["stages"]] == pytest.approx([80.0, 80.0])
    assert score(Path("recorded"), "mota") == pytest.approx(score(run, "mota"))


@pytest.mark.slow
def test_astyx_rewritten_as_ros_2(fbench, tmp_path, shared):
    own = tmp_path / "astyx.mcap"
    import_one(Astyx(), shared / "data" / "astyx", own)
    log = rewritten(own, tmp_path / "ros" / "drive.mcap")
    # Nothing in it tells that it was simulated, so that model and rules judge it.
    assert fbench("replay", own, "-p", "lidar3d", "--set", "lidar.judge=both", "-o", "base").code == 0
    run = quarter_of_an_hour(fbench, log, "lidar3d", ("--num", 2))
    assert fbench("score", run).code == 0
    assert score(run) == score(Path("base")) == pytest.approx(0.621, abs=0.001)
    config = (log.parent / "fbench.toml").read_text()
    assert config.count("velocity_period_mps = 10.394") == 2  # one radar, split in two, and it aliases
    assert fbench("replay", log, "-p", "radar3d", "-o", "radar").code == 0
    assert score(Path("radar")) > 0.75


@pytest.mark.slow
def test_a_log_of_another_tool(fbench, tmp_path, shared):
    log = tmp_path / "kitti" / "kitti.mcap"
    log.parent.mkdir()
    shutil.copy(shared / "data" / "mcap" / "kitti_raw_12frames_ros2.mcap", log)
    run = quarter_of_an_hour(fbench, log, "lidar3d", ("--num", 1))
    assert json.loads((run / "manifest.json").read_text())["num_frames"] == 12
    scored = fbench("score", run)
    assert scored.code == 3
    assert scored.err.endswith("the log has no truth, so there is nothing to score\n")
