"""A drive of a robot whose sensors all speak in the messages of their drivers, from `init` to a replay."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.program import fbench
from tests.replay.logs.codecs.oracles.velodyne_packets import STRONGEST, packets
from tests.replay.logs.codecs.ros import test_lidars, test_radar_lists
from tests.replay.logs.driver_logs import MS, DriverLog

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.codecs.velodyne import decode
from fbench.replay.logs.open import open_log
from fbench.replay.setup.init import draft_of, write_toml

START_NS = 1_700_000_000_000_000_000
NUM = 6
ONE, MANY = "conti_radar_msgs/msg/conti_Object", "conti_radar_msgs/msg/conti_Objects"
DEFINITIONS = {
    **test_lidars.VELODYNE, **test_lidars.livox("livox_ros_driver2"), test_radar_lists.ESR: test_radar_lists.TRACK,
    ONE: "\n".join(test_radar_lists.WORDS["conti"]), MANY: f"std_msgs/Header header\n{ONE}[] objects\n",
}  # fmt: skip


@pytest.fixture(params=["bag", "mcap"])
def drive(request, tmp_path) -> Path:
    """Six times 0.1 s of a Velodyne, a Livox, a planar scanner, a Continental and a Delphi radar."""
    log = DriverLog(request.param, DEFINITIONS, START_NS)
    make = log.ros.make
    for frame in ("velodyne", "livox_frame", "laser", "radar_front", "esr"):
        log.transform(frame)
    for i in range(NUM):
        stamp_ns = START_NS + i * 100 * MS
        stamp = divmod(stamp_ns, 10**9)
        data = packets(0x22, STRONGEST, num=3)
        log.add("/velodyne_packets", stamp_ns + MS, velodyne(log, data, stamp))
        points = [make("livox_ros_driver2/msg/CustomPoint", 100 * j, 5.0, 1.0, 0.1 * j, 9, 0, j) for j in range(20)]
        livox = log.ros.header("livox_frame", stamp), stamp_ns, 20, 1, np.zeros(3, np.uint8), points
        log.add("/livox/lidar", stamp_ns + 2 * MS, make("livox_ros_driver2/msg/CustomMsg", *livox))
        ranges = np.full(90, 4 + i, np.float32)
        rays = log.ros.header("laser", stamp), -0.785, 0.785, 0.01745, 1e-4, 0.1, 0.1, 30.0, ranges, ranges
        log.add("/scan", stamp_ns + 3 * MS, make("sensor_msgs/msg/LaserScan", *rays))
        objects = [make(ONE, j, 5.0 + j, 1.0, -1.0, 0.0, 0, 3.0) for j in range(3)]
        log.add("/conti/objects", stamp_ns + 4 * MS, make(MANY, log.ros.header("radar_front", stamp), objects))
        for j in range(1, 65):
            values = ("500", j, 0.0, False, False, j % 2, 10.0, float(j), False, False, 0.0, 0.0, 0, -6.0)
            track = make(test_radar_lists.ESR, log.ros.header("esr", stamp), *values)
            log.add("/esr/track", stamp_ns + 5 * MS + j * 1000, track)
    return log.write(tmp_path)


def velodyne(log, data, stamp):
    part = "velodyne_msgs/msg/VelodynePacket"
    parts = [log.ros.make(part, log.ros.time(stamp), packet) for packet in data]
    return log.ros.make(test_lidars.NAME, log.ros.header("velodyne", stamp), parts)


def test_every_sensor_is_read(drive):
    faults = FaultLog()
    reader = open_log(drive, faults)
    sizes: dict[str, list[int]] = {}
    for message in reader.messages():
        sizes.setdefault(message.sensor, []).append(len(message.xyz))
    num = len(decode(packets(0x22, STRONGEST, num=3)).xyz)
    assert {name: set(nums) for name, nums in sizes.items()} == {
        "velodyne": {num}, "livox_frame": {20}, "laser": {90}, "radar_front": {3}, "esr": {32},
    }  # fmt: skip
    assert {name: len(nums) for name, nums in sizes.items()} == dict.fromkeys(sizes, NUM) == dict(reader.num_messages)
    assert set(faults.counts) <= {"LOG006"}


def test_the_drive_is_set_up_and_replayed(drive, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert fbench("init", drive) == 0
    text = Path("fbench.toml").read_text()
    for topic in ("/velodyne_packets", "/livox/lidar", "/scan", "/conti/objects", "/esr/track"):
        assert f'topic = "{topic}"  # {NUM} messages, 10.0 Hz' in text
    assert "[sensors.velodyne]" in text
    assert fbench("replay", drive, "-p", "late3d", "-o", "run") == 0
    assert json.loads(Path("run/manifest.json").read_text())["num_frames"] == NUM
    assert fbench("log", "convert", drive, "-o", "copy.parquet") == 0
    assert fbench("replay", "copy.parquet", "-p", "late3d", "-o", "again") == 0
    digests = [json.loads(Path(run, "manifest.json").read_text())["digest"] for run in ("run", "again")]
    assert digests[0] == digests[1]


def test_clusters_come_before_the_objects_of_the_same_radar(tmp_path):
    fields = "\n".join(test_radar_lists.WORDS["ars408"])
    definitions = {f"ars/msg/{name}": fields for name in ("Cluster", "Object")}
    definitions |= {
        f"ars/msg/{name}List": f"std_msgs/Header header\n{name}[] parts\n" for name in ("Cluster", "Object")
    }
    log = DriverLog("bag", definitions, START_NS)
    for frame in ("radar", "rear"):
        log.transform(frame)
    for i, (name, frame) in enumerate([("Object", "radar"), ("Cluster", "radar"), ("Object", "rear")]):
        parts = [log.ros.make(f"ars/msg/{name}", 1, 5.0, 1.0, -1.0, 0.0, 0, 3.0)] * (i + 1)
        message = log.ros.make(f"ars/msg/{name}List", log.ros.header(frame), parts)
        log.add(f"/{frame}/{name.lower()}s", START_NS + i, message)
    path = log.write(tmp_path)
    reader = open_log(path, FaultLog())
    assert {m.sensor: len(m.xyz) for m in reader.messages()} == {"radar": 2, "rear": 3}
    text = write_toml(draft_of(path, tmp_path / "fbench.toml", FaultLog())).text
    assert 'topic = "/radar/clusters"' in text
    assert 'topic = "/rear/objects"' in text
    assert "#   /radar/objects: another form of what /radar/clusters holds" in text
