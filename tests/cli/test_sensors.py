"""`--sensors` and `--set SENSOR.NAME=VALUE`."""

import json
from pathlib import Path

import pytest
from tests.cli.conftest import messages, rig, truths, write_log

from fbench.replay.data.rig import Rig


def manifest(folder="run"):
    return json.loads(Path(folder, "manifest.json").read_text())


def two_lidars(tmp_path):
    """The LiDAR `left.top` has a twin that gives the same messages."""
    one = rig(camera=False)
    mounts = {"left.top": one.mounts["lidar"], "right.top": one.mounts["lidar"], "radar": one.mounts["radar"]}
    items = []
    for message in messages(camera=False):
        names = ("left.top", "right.top") if message.sensor == "lidar" else ("radar",)
        items += [type(message)(**{**vars(message), "sensor": name}) for name in names]
    return write_log(tmp_path / "two.mcap", [*items, *truths()], Rig(mounts, {}))


def test_a_run_with_some_of_the_sensors(fbench, log):
    assert fbench("replay", log, "-p", "late3d", "-o", "all").code == 0
    result = fbench("replay", log, "-p", "late3d", "--sensors", "!radar,!cam*", "-o", "run", "--json")
    assert result.code == 0
    chosen, whole = manifest(), manifest("all")
    assert chosen["frames"]["sensors"] == ["!radar", "!cam*"]
    assert chosen["log"]["digest"] == whole["log"]["digest"]
    assert chosen["num_frames"] == whole["num_frames"] == 6
    assert chosen["frames"]["reference"] == whole["frames"]["reference"] == "lidar"
    assert chosen["cameras"] == whole["cameras"]


def test_a_pipeline_that_gets_nothing_it_needs(fbench, log):
    result = fbench("replay", log, "-p", "lidar3d", "--sensors", "radar")
    assert result.code == 3
    assert result.err == "fbench: log 'car': lidar3d needs a LiDAR; the log has: radar radar [CFG001]\n"
    assert list(Path("runs").iterdir()) == []


@pytest.mark.slow
def test_patterns_that_fit_nothing(fbench, log, in_this_process):
    in_this_process()
    result = fbench("replay", log, "-p", "lidar3d", "--sensors", "lidra")
    assert result.code == 2
    assert "--sensors lidra: fits no sensor; did you mean 'lidar'?" in result.err
    assert fbench("verify", log, "-p", "lidar3d", "--quick", "--sensors", "lidra").code == 2
    assert fbench("log", "check", log, "--sensors", "lidra").code == 2
    assert fbench("replay", log, "-p", "lidar3d", "--sensors", "a,,b").code == 2


@pytest.mark.slow
def test_verify_with_some_of_the_sensors(fbench, log, circumstances, in_this_process):
    circumstances("repeat")
    in_this_process()
    result = fbench("verify", log, "-p", "lidar3d", "--quick", "--sensors", "lidar", "--keep", "kept")
    assert result.code == 0, result.out
    runs = [manifest(path.parent) for path in Path("kept").glob("*/manifest.json")]
    assert runs
    assert {tuple(run["frames"]["sensors"]) for run in runs} == {("lidar",)}


def test_check_waits_for_some_of_the_sensors(fbench, tmp_path):
    log = write_log(tmp_path / "log.mcap", [m for m in messages() if m.sensor != "radar" or m.stamp_ns < 1_300_000_000])
    command = ("log", "check", log, "--reference", "lidar")
    whole, chosen = fbench(*command, "--json"), fbench(*command, "--sensors", "!radar", "--json")
    assert whole.json()["frames"]["num_complete"] == 3
    assert chosen.json()["frames"]["num_complete"] == 6
    assert [s["sensor"] for s in chosen.json()["streams"]] == ["camera", "lidar", "radar"]
    result = fbench(*command, "-p", "radar3d", "--sensors", "!radar")
    assert result.code == 1
    assert "radar3d needs a radar" in result.out


@pytest.mark.slow
def test_parameters_of_one_sensor(fbench, tmp_path):
    log = two_lidars(tmp_path)
    settings = ["--set", "left.top.max_range_m=5", "--set", "lidar.min_range_m=2"]
    assert fbench("replay", log, "-p", "lidar3d", *settings, "-o", "run").code == 0
    parameters = manifest()["parameters"]
    assert (parameters["left.top.max_range_m"], parameters["lidar.min_range_m"]) == ("5", 2.0)
    assert "by_sensor" not in parameters
    result = fbench("replay", log, "-p", "lidar3d", "--set", "leftt.top.max_range_m=5")
    assert result.code == 2
    assert "no such sensor or parameter; did you mean 'left.top.max_range_m'?" in result.err
    result = fbench("replay", log, "-p", "lidar3d", "--set", "left.top.cluster.eps_m=5")
    assert result.code == 2
    assert "it is common to all LiDARs, set lidar.cluster.eps_m" in result.err


def test_plugins_explain_parameters_by_sensor(fbench):
    text = " ".join(fbench("plugins", "pipelines", "late3d").out.split())
    assert "SENSOR.NAME" in text
    assert "by_sensor" not in text
