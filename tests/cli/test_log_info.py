"""`fbench log info`, as a user calls it."""

import json

import numpy as np
import pytest
from tests.cli.conftest import UPRIGHT, car_points, messages, rig, truths, write_log

from fbench.replay.data.messages import PointCloud
from fbench.replay.data.rig import LogInfo, Mount, Rig
from fbench.replay.logs.containers.mcap.write import McapWriter


def test_table_and_json(fbench, log):
    text, content = fbench("log", "info", log), fbench("log", "info", log, "--json")
    assert text.code == content.code == 0
    assert "6 frames by lidar, 1 segment, 6 messages of truth" in text.out
    assert "stored: MCAP, compression zstd, 1 chunk, " in text.out
    assert "80x60, f 60 px" in text.out
    assert "x, y, z on the body [m]" in text.out
    assert "/truth/boxes" in text.out
    assert text.out.endswith("not verified; see fbench log check\n")
    info = content.json()
    assert info["storage"]["is_indexed"] is True
    assert info["uncalibrated"] == {}
    assert info["verified"] is False
    assert [t["kind"] for t in info["topics"]] == ["calibration", "camera", "lidar", "radar", "transform", "truth"]
    assert info["first_log_ns"] == 1_000_000_000
    assert info["streams"][1]["median_period_ns"] == 100_000_000


def test_incomplete_rig_does_not_keep_it_from_showing_the_rest(fbench, tmp_path):
    full = rig()
    log = write_log(tmp_path / "log.mcap", messages(), Rig(full.mounts, {}))
    result = fbench("log", "info", log)
    assert result.code == 0
    assert "no calibration: camera 'camera' has no calibration" in result.out
    assert "6 frames by lidar" in result.out
    assert list(fbench("log", "info", log, "--json").json()["uncalibrated"]) == ["camera"]


def test_damaged_and_foreign_files(fbench, tmp_path):
    log = write_log(tmp_path / "log.mcap", [*messages(), *truths()])
    log.write_bytes(log.read_bytes()[:-40])
    result = fbench("log", "info", log)
    assert result.code == 4
    assert "fault: LOG002" in result.out
    assert "no index" in result.out
    other = tmp_path / "other.mcap"
    other.write_bytes(b"hello")
    assert fbench("log", "info", other).code == 3
    assert fbench("log", "info", tmp_path / "none.mcap").code == 3


@pytest.mark.parametrize("name", ["\x1b[31mred", "[/red]", "[bold]x"])
def test_names_steer_no_terminal_and_are_no_markup(fbench, tmp_path, name):
    mounts = {name: Mount("lidar", np.zeros(3), UPRIGHT)}
    log = write_log(tmp_path / "a.mcap", [PointCloud(name, 1, 1, car_points(12))], Rig(mounts, {}))
    result = fbench("log", "info", log)
    assert result.code == 0
    assert name.replace("\x1b", " ") in result.out
    assert "\x1b" not in result.out + fbench("log", "check", log).out


def test_long_metadata_are_cut(fbench, tmp_path):
    log = tmp_path / "log.mcap"
    rig = Rig({"top": Mount("lidar", np.array([-0.0001, 0, 1]), np.array([0, 0, 0, 1.0]))}, {})
    with McapWriter(log, LogInfo("log", "log-1", {"tokens": "abcdefgh " * 100}), rig):
        pass
    text = fbench("log", "info", log).out
    assert "… (900 characters, all with --json)" in text
    assert "0.00, 0.00, 1.00" in text
    assert "-0.00" not in text
    assert json.loads(fbench("log", "info", log, "--json").out)["metadata"]["tokens"] == "abcdefgh " * 100


def test_one_is_no_plural(fbench, tmp_path):
    log = write_log(tmp_path / "log.mcap", [*messages(1), *truths(1)])
    info, check = fbench("log", "info", log), fbench("log", "check", log)
    assert ", 1 frame by lidar, 1 segment, 1 message of truth" in info.out
    assert ", 1 chunk," in info.out
    assert ": 1 frame by lidar, 1 complete, 1 segment, 1 with truth" in check.out
