"""Logs of LiDARs in packets: turns that are put together on the way, counted, checked, replayed and converted."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.program import fbench
from tests.replay.logs.codecs.oracles.ouster_packets import START_NS, STEP_NS, metadata, packets
from tests.replay.logs.codecs.ros.builders import cloud, structured
from tests.replay.logs.driver_logs import MS, DriverLog

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import PointCloud
from fbench.replay.logs.codecs.ouster import read_metadata
from fbench.replay.logs.open import open_log

PROFILE = "RNG15_RFL8_NIR8"
PERIOD_NS = 100 * MS
PACKET = {"ouster_ros/msg/PacketMsg": "uint8[] buf\n", "ouster_sensor_msgs/msg/PacketMsg": "uint8[] buf\n"}


class Log(DriverLog):
    """A log with packets of an Ouster."""

    def __init__(self, form: str) -> None:
        super().__init__(form, PACKET, START_NS)

    def text(self, text: str, topic: str = "/ouster/metadata") -> None:
        self.add(topic, START_NS, self.ros.make("std_msgs/msg/String", text))

    def packet(self, data: bytes, log_ns: int, topic: str = "/ouster/lidar_packets") -> None:
        package = "ouster_ros" if self.form == "bag" else "ouster_sensor_msgs"
        self.add(topic, log_ns, self.ros.make(f"{package}/msg/PacketMsg", np.frombuffer(data, np.uint8)))

    def turns(self, num: int = 5, skip: tuple[int, ...] = (), start_ns: int = START_NS) -> None:
        """Packets of some turns, each recorded 1 ms after it was measured; `skip` are left out."""
        for i in range(num):
            for j, data in enumerate(packets(PROFILE, frame=65_534 + i & 0xFFFF, start_ns=start_ns + i * PERIOD_NS)):
                if 4 * i + j not in skip:
                    self.packet(data, START_NS + i * PERIOD_NS + (j + 1) * 16 * STEP_NS + MS)


def opened(path: Path):
    faults = FaultLog()
    return open_log(path, faults), faults


@pytest.fixture(params=["bag", "mcap"])
def log(request):
    made = Log(request.param)
    made.text(metadata(PROFILE))
    made.transform("os_lidar")
    return made


def test_packets_become_turns(log, tmp_path):
    log.turns()
    log.packet(bytes(48), START_NS + 3, "/ouster/imu_packets")
    reader, faults = opened(log.write(tmp_path))
    turns = [m for m in reader.messages() if isinstance(m, PointCloud)]
    assert [m.stamp_ns for m in turns] == [START_NS + i * PERIOD_NS for i in range(5)]
    assert [m.log_ns - m.stamp_ns for m in turns] == [64 * STEP_NS + MS] * 5  # when the last packet came
    whole = read_metadata(metadata(PROFILE)).decode(packets(PROFILE))
    np.testing.assert_array_equal(turns[2].xyz, whole.xyz)
    np.testing.assert_array_equal(turns[2].offset_ns, whole.time_ns)
    assert (turns[2].sensor, reader.num_messages["os_lidar"]) == ("os_lidar", 5)
    assert reader.rig.mounts["os_lidar"].translation_m.tolist() == [1, 0, 2]
    assert set(faults.counts) <= {"LOG006"}  # neither the metadata nor the IMU are missed


def test_turns_of_which_packets_are_missing(log, tmp_path):
    """Such a turn is whole when the next one begins; what the log ends with is never whole."""
    log.turns(num=4, skip=(3, 4, 14))
    reader, _ = opened(log.write(tmp_path))
    turns = list(reader.messages())
    packet = [len(read_metadata(metadata(PROFILE)).decode([data]).xyz) for data in packets(PROFILE)]
    assert [len(m.xyz) for m in turns] == [sum(packet[:3]), sum(packet[1:]), sum(packet)]
    assert [m.log_ns - START_NS - MS for m in turns] == [
        PERIOD_NS + 32 * STEP_NS, 2 * PERIOD_NS + 16 * STEP_NS, 2 * PERIOD_NS + 64 * STEP_NS,
    ]  # fmt: skip
    assert turns[1].stamp_ns == START_NS + PERIOD_NS + 16 * STEP_NS


def test_packets_that_come_late_or_twice(log, tmp_path):
    """Within a turn the order doesn't matter; a packet of a turn that is over is left out."""
    first, second = packets(PROFILE, 7), packets(PROFILE, 8, START_NS + PERIOD_NS)
    for i, data in enumerate([first[1], first[0], first[2], second[0], first[3], *second[1:], second[3]]):
        log.packet(data, START_NS + i)
    turns = list(opened(log.write(tmp_path))[0].messages())
    assert [m.log_ns - START_NS for m in turns] == [3, 7]
    assert len(turns[1].xyz) == len(read_metadata(metadata(PROFILE)).decode(second).xyz)


def test_a_sensor_that_starts_again_goes_on(log, tmp_path):
    for i, number in enumerate([5000, 0, 1]):
        for data in packets(PROFILE, number, START_NS + i * PERIOD_NS):
            log.packet(data, START_NS + i * PERIOD_NS)
    assert len(list(opened(log.write(tmp_path))[0].messages())) == 3


def test_a_sensor_with_a_clock_of_its_own_gets_times_of_recording(log, tmp_path):
    """It counts from when it was switched on, unless it is synchronized."""
    log.turns(num=2, start_ns=77_000_000_000)
    turns = list(opened(log.write(tmp_path))[0].messages())
    assert [m.stamp_ns - START_NS for m in turns] == [16 * STEP_NS + MS, PERIOD_NS + 16 * STEP_NS + MS]
    assert turns[0].offset_ns.max() == 63 * STEP_NS


def test_damaged_packets_are_counted_and_the_turn_goes_on(log, tmp_path):
    log.turns(num=2, skip=(1,))
    log.packet(bytes(77), START_NS + 2 * 16 * STEP_NS)
    reader, faults = opened(log.write(tmp_path))
    assert len(list(reader.messages())) == 2
    assert len(list(reader.messages())) == 2  # a second pass starts afresh
    assert faults.counts["DEC001"] == 1
    assert "packet of 77 bytes, but by the sensor's metadata it has 1280" in faults.places["DEC001"][0]


@pytest.mark.parametrize(
    ("texts", "why"),
    [
        ({}, "need its metadata, a std_msgs/String on 'metadata' beside them"),
        ({"/left/metadata": metadata(PROFILE), "/right/metadata": metadata(PROFILE)}, "need its metadata"),
        ({"/ouster/metadata": metadata(PROFILE).replace(PROFILE, "FUTURE")}, "have the profile 'FUTURE'"),
    ],
)
def test_packets_that_nothing_explains_are_left_out(texts, why, tmp_path):
    made = Log("mcap")
    for topic, text in texts.items():
        made.text(text, topic)
    made.turns(num=1)
    reader, faults = opened(made.write(tmp_path))
    assert list(reader.messages()) == []
    (place,) = [place for place in faults.places["LOG013"] if "/ouster/lidar_packets" in place]
    assert why in place
    assert faults.num_lost == 0


def test_metadata_of_the_same_namespace_count(tmp_path):
    made = Log("bag")
    made.text("no metadata", "/right/metadata")
    made.text(metadata(PROFILE), "/left/metadata")
    for data in packets(PROFILE):
        made.packet(data, START_NS, "/left/lidar_packets")
    assert len(list(opened(made.write(tmp_path))[0].messages())) == 1


def test_a_log_with_packets_from_init_to_report(log, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    log.turns(num=12)
    log.packet(bytes(48), START_NS + 3, "/ouster/imu_packets")
    path = log.write(tmp_path)
    assert fbench("log", "info", path, "--json") == 0
    (row,) = json.loads(capfd.readouterr().out)["streams"]
    assert (row["sensor"], row["num_messages"]) == ("os_lidar", 12)
    assert row["rate_hz"] == pytest.approx(10, abs=0.01)
    assert not row["is_estimate"]  # few enough to count them all
    assert fbench("log", "check", path, "--ignore", "LOG006") == 0
    assert "LOG01" not in capfd.readouterr().out  # the metadata are of use
    assert fbench("init", path) == 0
    text = Path("fbench.toml").read_text()
    assert '"/ouster/lidar_packets"  # 12 messages, 10.0 Hz' in text
    assert "#   /ouster/imu_packets: packets of the IMU, which fbench has no use for" in text
    for name in (path, "copy.mcap", "copy.parquet", "decoded.mcap"):
        if name != path:
            decode = ("--decode",) if str(name).startswith("decoded") else ()
            assert fbench("log", "convert", path, "-o", name, *decode, "--config", "none") == 0
        assert (
            fbench("replay", name, "-p", "lidar3d", "-o", f"run-{Path(name).name}", "--config", "none", "--overwrite")
            == 0
        )
    runs = [
        json.loads((Path(f"run-{n}") / "manifest.json").read_text()) for n in (path.name, "copy.mcap", "decoded.mcap")
    ]
    assert [run["num_frames"] for run in runs] == [12] * 3


def test_a_turn_that_is_cut_off_is_not_counted(tmp_path):
    """Of eleven packets of four a turn, two turns can be whole, and come."""
    made = Log("mcap")
    made.text(metadata(PROFILE))
    made.transform("os_lidar")
    made.turns(num=3, skip=(11,))
    reader, _ = opened(made.write(tmp_path))
    assert reader.num_messages["os_lidar"] == len(list(reader.messages())) == 2
    assert not reader.estimated


def test_clouds_that_a_driver_made_of_packets_come_first(tmp_path, monkeypatch, capfd):
    """A bag with `/ouster/points` beside the packets, and with a planar scan of the same device."""
    monkeypatch.chdir(tmp_path)
    made = Log("bag")
    made.text(metadata(PROFILE))
    made.transform("os_sensor")
    made.turns()
    ros, axis = made.ros, np.arange(5, dtype="f4")
    for i in range(5):
        stamp_ns = START_NS + i * PERIOD_NS
        stamp = divmod(stamp_ns, 10**9)
        points = cloud(ros, structured(x=axis, y=axis + i, z=axis), frame_id="os_sensor", stamp=stamp)
        made.add("/ouster/points", stamp_ns + 70 * MS, points)
        ranges, none = np.ones(4, np.float32), np.zeros(0, np.float32)
        scan = ros.make("sensor_msgs/msg/LaserScan", ros.header("os_sensor", stamp), 0.0, 1.0, 0.1, 0.0, 0.1, 0.1, 9.0,
                        ranges, none)  # fmt: skip
        made.add("/ouster/scan", stamp_ns + 71 * MS, scan)
    path = made.write(tmp_path)
    reader, faults = opened(path)
    assert {m.sensor for m in reader.messages()} == {"os_sensor"}
    assert [len(m.xyz) for m in reader.messages()] == [5] * 5
    left_out = [place for place in faults.places["LOG012"] if "is left out" in place]
    assert all("'/ouster/points' holds the measurements of the same sensor" in place for place in left_out)
    assert len(left_out) == 2
    assert fbench("init", path) == 0
    text = Path("fbench.toml").read_text()
    assert 'topic = "/ouster/points"' in text
    assert "#   /ouster/lidar_packets: another form of what /ouster/points holds" in text
    text = text.replace('topic = "/ouster/points"', 'topic = "/ouster/lidar_packets"\nframe = "os_sensor"')
    Path("fbench.toml").write_text(text)
    capfd.readouterr()
    assert fbench("log", "info", path, "--json") == 0
    (row,) = json.loads(capfd.readouterr().out)["streams"]
    assert row["num_messages"] == 5


def test_rate_of_packets_is_not_that_of_turns(log, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    log.turns(num=1)
    assert fbench("init", log.write(tmp_path)) == 0
    text = Path("fbench.toml").read_text()
    assert 'reference = "ouster_lidar"  # the slowest, rate unknown;' in text
    assert "tolerance_ms = 50.0  # guess: default: the period is unknown" in text
