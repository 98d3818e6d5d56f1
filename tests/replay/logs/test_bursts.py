"""Radars and LiDARs that send one measurement as several messages with one stamp."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.program import fbench
from tests.replay.logs import builders as b
from tests.replay.logs.codecs.ros.builders import cloud, structured
from tests.replay.logs.test_two_types_of_tf import ROS, START_NS, TYPES, transform, write_bag

from fbench.replay.data.messages import Image, PointCloud, RadarScan
from fbench.replay.data.rig import Mount, Rig
from fbench.replay.logs.bursts import join_bursts, mean_parts

MS = 1_000_000


def radar(stamp_ms: float, late_ms: float, x: float, sensor: str = "front", **more) -> RadarScan:
    xyz = np.array([[x, 0, 0], [x, 1, 0]], np.float32)
    stamp_ns = 1_000 * MS + round(stamp_ms * MS)
    return RadarScan(sensor, stamp_ns, stamp_ns + round(late_ms * MS), xyz, xyz[:, 0].copy(), **more)


def xs(event) -> list[float]:
    return event.xyz[::2, 0].tolist()


def test_parts_become_one_measurement_in_their_order():
    lidar = PointCloud("top", 1_000 * MS, 1_003 * MS, np.zeros((1, 3), np.float32))
    parts = [radar(0, 1, 5), radar(0, 2, 3), lidar, radar(0, 4, 7), radar(100, 101, 1)]
    joined = list(join_bursts(parts, frozenset(["front"])))
    assert joined[0] is lidar
    assert xs(joined[1]) == [5, 3, 7]
    assert joined[1].radial_velocity_mps.tolist() == [5, 5, 3, 3, 7, 7]
    assert (joined[1].stamp_ns, joined[1].log_ns) == (1_000 * MS, 1_004 * MS)
    assert joined[2] is parts[-1]
    assert len(joined) == 3


def test_what_only_some_parts_have_is_left_out():
    xyz = np.ones((1, 3), np.float32)
    a = PointCloud("top", 9, 9, xyz, intensity=xyz[:, 0], ring=np.array([4], np.uint16))
    second = PointCloud("top", 9, 10, 2 * xyz, ring=np.array([5], np.uint16))
    (joined,) = join_bursts([a, second], frozenset(["top"]))
    assert joined.intensity is None
    assert joined.ring.tolist() == [4, 5]
    assert joined.ring.dtype == np.uint16


@pytest.mark.parametrize(
    ("second", "why"),
    [
        (radar(0, 2, 5), "exact duplicates stay two"),
        (radar(0, 60, 3), "a clock that stands still"),
        (radar(0, 2, 3, frame_number=1), "another frame"),
        (radar(0, 2, 3, "rear"), "another sensor"),
        (radar(1, 2, 3), "another stamp"),
    ],
)
def test_what_is_no_burst(second, why):
    first = radar(0, 1, 5)
    assert list(join_bursts([first, second], frozenset(["front", "rear"]))) == [first, second], why
    assert second.sensor == "rear" or mean_parts([first, second] * 3) == 1


def test_two_sensors_may_send_bursts_at_once():
    parts = [radar(0, 1, 5), radar(0, 1.5, 1, "rear"), radar(0, 2, 3), radar(0, 2.5, 2, "rear"), radar(50, 51, 9)]
    joined = list(join_bursts(parts, frozenset(["front", "rear"])))
    assert [(event.sensor, xs(event)) for event in joined] == [("front", [5, 3]), ("rear", [1, 2]), ("front", [9])]


def test_without_bursts_nothing_changes():
    events = b.sequence(20)
    assert list(join_bursts(iter(events), frozenset())) == events
    assert list(join_bursts(iter(events), frozenset(["front", "top"]))) == events
    assert mean_parts(Image("cam", i // 2, i, b"", "jpeg", (1, 1)) for i in range(9)) == 1


def test_mean_parts_of_a_log_that_begins_within_a_burst():
    whole = [radar(100 * scan, part, 10 * scan + part) for scan in range(12) for part in range(8)]
    assert mean_parts(whole) == 8
    assert mean_parts(whole[7:]) == pytest.approx(64 / 9)
    assert mean_parts([]) == 1


RIG = Rig({"front": Mount("radar", np.zeros(3), np.array([0, 0, 0, 1.0]))}, {})


@pytest.mark.parametrize("form", ["mcap", "parquet"])
def test_every_part_reaches_a_frame(tmp_path, monkeypatch, form):
    monkeypatch.chdir(tmp_path)
    parts = [radar(50 * scan, part, 10 * scan + part) for scan in range(18) for part in range(8)]
    b.write(tmp_path / "drive.mcap", parts, RIG)
    if form == "parquet":
        assert fbench("log", "convert", "drive.mcap", "-o", "drive.parquet") == 0
    result = fbench("replay", f"drive.{form}", "-p", "radar3d", "-o", "run")
    assert result == 0
    faults = json.loads(Path("run/faults.json").read_text())
    manifest = json.loads(Path("run/manifest.json").read_text())
    assert manifest["num_frames"] == 18
    assert faults["unused_messages"] == {"front": 0}
    assert not any(row["count"] for row in faults["rows"])


def test_the_slowest_sensor_is_that_with_the_fewest_measurements(tmp_path, monkeypatch, capfd):
    """Eight messages every 100 ms are slower than one every 50 ms."""
    monkeypatch.chdir(tmp_path)
    messages = [("/tf", transform(TYPES[1], "lidar", 1.0)), ("/tf", transform(TYPES[1], "radar", 3.0))]
    for i in range(40):
        stamp = divmod(START_NS + i * 50 * MS, 10**9)
        points = np.arange(3, dtype="<f4") + i
        messages.append(("/lidar", cloud(ROS, structured(x=points, y=points, z=points), stamp=stamp)))
        for part in range(8 if i % 2 == 0 else 0):
            echoes = dict.fromkeys(("x", "y", "z", "velocity"), points + part)
            messages.append(("/radar", cloud(ROS, structured(**echoes), frame_id="radar", stamp=stamp)))
    write_bag(tmp_path / "drive.bag", messages)
    assert fbench("init", "drive.bag") == 0
    text = Path("fbench.toml").read_text()
    assert '"/radar"  # 20 messages' in text  # all were looked at
    Path("fbench.toml").unlink()
    capfd.readouterr()
    assert fbench("log", "info", "drive.bag", "--json") == 0
    sensors = {row["sensor"]: row for row in json.loads(capfd.readouterr().out)["streams"]}
    assert sensors["radar"]["num_messages"] == 20
    assert sensors["radar"]["rate_hz"] < sensors["lidar"]["rate_hz"]
    assert (sensors["radar"]["is_estimate"], sensors["lidar"]["is_estimate"]) == (True, False)
    assert fbench("log", "info", "drive.bag") == 0
    said = capfd.readouterr().out
    assert " ≈20 frames by radar," in said
    assert next(line for line in said.splitlines() if line.startswith("radar ")).split()[2] == "≈20"
    fbench("log", "check", "drive.bag", "--json")
    assert "TIM003" not in capfd.readouterr().out
    result = fbench("replay", "drive.bag", "-p", "radar3d", "-o", "run", "--tolerance-ms", "20")
    manifest = json.loads(Path("run/manifest.json").read_text())
    assert result == 0
    assert "integrity: unknown, as the log has no checksums; fbench log convert writes one" in capfd.readouterr().out
    assert (manifest["frames"]["reference"], manifest["num_frames"]) == ("radar", 20)
