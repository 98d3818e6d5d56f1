"""Options of `fbench replay` that choose frames, topics and stamps, and set the pace."""

import json
from pathlib import Path

import pytest
from tests.cli.conftest import messages, rig, write_log

from fbench.replay.data.messages import PointCloud
from fbench.replay.runs.digest import digest
from fbench.replay.runs.folder import Run


def rows(folder, table="detections"):
    run = Run(Path(folder))
    return {f.index: digest(getattr(run, table).at(f.index)) for f in run.frames}


@pytest.mark.parametrize(
    "options", [("--frames", "2:5"), ("--from", "0.2", "--to", "0.5"), ("--from", "1200000000ns", "--frames", ":5")]
)
def test_part_of_a_log_gives_the_detections_of_the_whole(fbench, log, options):
    assert fbench("replay", log, "-p", "lidar3d", "-o", "whole").code == 0
    result = fbench("replay", log, "-p", "lidar3d", "-o", "part", *options, "--report", "--json")
    assert result.code == 0
    whole, part = rows("whole"), rows("part")
    assert list(part) == [2, 3, 4]
    assert part == {index: whole[index] for index in part}
    assert rows("part", "tracks") != {i: row for i, row in rows("whole", "tracks").items() if i in part}
    assert {r["code"]: r["count"] for r in result.json()["faults"]["rows"]}["GT006"] == 0
    coverage = next(s for s in result.json()["scores"] if s["metric"] == "coverage")
    assert coverage["counts"] == {"scored": 3, "frames": 3}


def test_truth_of_chosen_frames_is_scored_as_in_the_whole(fbench, log):
    fbench("replay", log, "-p", "lidar3d", "-o", "part", "--frames", "4:")
    run = Run(Path("part"))
    assert [f.truth_stamp_ns for f in run.frames] == [1_400_000_000, 1_500_000_000]
    assert run.truth3d(4).center_m[0, 0] == 16.0
    assert run.truth3d(0) is None


def test_topics(fbench, log):
    assert fbench("replay", log, "-p", "lidar3d", "-o", "run", "--topics", "lidar", "--topics", "radar").code == 0
    run = Run(Path("run"))
    assert run.manifest.frames.topics == ["lidar", "radar"]
    assert list(run.manifest.mounts) == ["lidar", "radar"]
    assert run.frames[0].missing == {}


def boot_time_log(tmp_path):
    """A LiDAR whose stamps count from the start of the sensor."""
    items = []
    for m in messages(6):
        arrival = m.log_ns + 1_700_000_000_000_000_000
        stamp = m.stamp_ns if isinstance(m, PointCloud) else m.stamp_ns + 1_700_000_000_000_000_000
        items.append(type(m)(**{**vars(m), "log_ns": arrival, "stamp_ns": stamp}))
    return write_log(tmp_path / "boot.mcap", items, rig())


def test_clock_of_one_sensor_is_another(fbench, tmp_path):
    log = boot_time_log(tmp_path)
    result = fbench("replay", log, "-p", "lidar3d")
    assert result.code == 3
    assert "its clock differs from that of 'lidar' by 1700000000.001 s" in result.err
    assert "[TIM008]" in result.err
    assert not Path("runs/boot-lidar3d").exists()
    for options in (("--stamps", "log"), ("--offset", "lidar=1700000000000")):
        assert fbench("replay", log, "-p", "lidar3d", *options, "--overwrite").code == 0
        assert [f.missing for f in Run(Path("runs/boot-lidar3d")).frames] == [{}] * 6


def test_pace_is_measured(fbench, log):
    paced = fbench("replay", log, "-p", "radar3d", "-o", "paced", "--rate", "5")
    assert "pace: asked 5x, achieved " in paced.out
    assert "ms, max " in paced.out
    host = json.loads(Path("paced/host.json").read_text())
    assert 0 < host["achieved_rate"] < 5.5
    assert 0 <= host["p99_late_ms"] <= host["max_late_ms"]
    free = fbench("replay", log, "-p", "radar3d", "-o", "free")
    assert "x real time" in free.out
    assert "p99_late_ms" not in json.loads(Path("free/host.json").read_text())


def test_stragglers_are_told_apart(fbench, tmp_path):
    items = list(messages(6))
    late = [i for i, m in enumerate(items) if m.sensor == "radar"][2]
    items[late] = type(items[late])(**{**vars(items[late]), "log_ns": items[late].log_ns + 60_000_000})
    items.append(type(items[late])(**{**vars(items[late]), "log_ns": items[late].log_ns + 1}))
    result = fbench("replay", write_log(tmp_path / "late.mcap", items), "-p", "radar3d", "-o", "run")
    assert "late: 1 message of radar came after its frame was released" in result.out
    assert "unused: 1 message of radar, which frames don't need" in result.out
    faults = json.loads(Path("run/faults.json").read_text())
    assert faults["late_messages"] == {"camera": 0, "lidar": 0, "radar": 1}
    assert faults["unused_messages"] == {"camera": 0, "lidar": 0, "radar": 1}


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (("--frames", "x"), 2, "--frames x: expected A:B"),
        (("--frames", "6:"), 3, "has no frames in the range 'frames 6:'; it has 6 over 0.500 s"),
        (("--from", "9"), 3, "has no frames in the range 'from +9000000000ns'"),
        (("--from", "x"), 2, "--from x: expected seconds"),
        (("--to", "0"), 3, "has no frames in the range 'to +0ns'"),
        (("--topics", "lidr"), 2, "did you mean 'lidar'?"),
        (("--offset", "lidr=3"), 2, "--offset lidr: no such sensor; did you mean 'lidar'?"),
        (("--offset", "3"), 2, "--offset 3: expected SENSOR=MILLISECONDS"),
        (("--stamps", "gps"), 2, "--stamps gps: expected 'header' or 'log'"),
        (("--read-ahead", "few"), 2, "--read-ahead few: expected a number of messages"),
    ],
)
def test_bad_options(fbench, log, options, code, message):
    result = fbench("replay", log, "-p", "lidar3d", *options)
    assert result.code == code
    assert message in result.err
    assert result.err.count("\n") == 1
    assert not Path("runs/car-lidar3d").exists()


def test_reference_that_the_log_names_may_be_left_out(fbench, tmp_path):
    log = write_log(tmp_path / "log.mcap", messages(), metadata={"reference": "lidar"})
    result = fbench("replay", log, "-p", "radar3d", "--topics", "!lidar", "-o", "run")
    assert result.code == 0
    assert json.loads(Path("run/manifest.json").read_text())["frames"]["reference"] == "camera"
    assert fbench("replay", log, "-p", "radar3d", "--topics", "!lidar", "--reference", "lidar", "-o", "x").code == 2
