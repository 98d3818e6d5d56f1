"""`fbench log check`, as a user calls it."""

from pathlib import Path

import pytest
from tests.cli.conftest import messages, rig, truths, write_log
from tests.cli.test_fault_matrix import foreign

from fbench.replay.data.rig import Rig

STREAM = {
    "sensor": "lidar", "kind": "lidar", "num_messages": 6, "first_stamp_ns": 1_000_000_000,
    "last_stamp_ns": 1_500_000_000, "rate_hz": 10.0, "median_period_ns": 100_000_000, "max_gap_ns": 100_000_000,
    "jitter_p99_ns": 0, "num_lost": 0, "num_irregular": 0, "num_gaps": 0, "num_duplicates": 0, "num_equal_stamps": 0,
    "num_disordered": 0, "max_inversion_ns": 0, "num_jumps": 0, "num_zero_stamps": 0, "num_unordered": 0,
    "skew_median_ns": 1_000_000, "skew_min_ns": 1_000_000, "skew_max_ns": 1_000_000,
}  # fmt: skip


def test_clean_log(fbench, log):
    text, content = fbench("log", "check", log), fbench("log", "check", log, "--json")
    assert text.code == content.code == 0
    assert text.err == content.err == ""
    assert "6 frames by lidar, 6 complete, 1 segment, 6 with truth" in text.out
    assert text.out.endswith("\nclean\n")
    result = content.json()
    assert list(result) == [
        "name", "log_id", "clean", "findings", "storage", "reference", "streams", "frames", "truth", "topics",
    ]  # fmt: skip
    assert result["clean"] is True
    assert result["findings"] == []
    assert result["streams"][1] == STREAM
    assert result["truth"] == {"messages": 6, "frames": 6}


def test_findings_are_told_with_what_to_do(fbench, tmp_path):
    log = write_log(tmp_path / "log.mcap", [*messages(), *list(messages())[-1:]], Rig(rig().mounts, {}))
    text, content = fbench("log", "check", log), fbench("log", "check", log, "--json")
    assert text.code == content.code == 1
    lines = text.out.splitlines()
    assert lines[-1] == "2 findings"
    at = next(i for i, line in enumerate(lines) if line.startswith("error CAL001 camera: camera 'camera' has no"))
    assert lines[at + 1].strip().startswith("→ record the calibration")
    findings = content.json()["findings"]
    assert [(f["severity"], f["code"], f["source"]) for f in findings] == [
        ("error", "CAL001", "camera"), ("warning", "TIM004", "radar"), ("info", "GT001", ""),
    ]  # fmt: skip
    assert findings[1] == {
        "code": "TIM004", "severity": "warning", "source": "radar",
        "text": "1 of 7 messages are exact duplicates of others", "count": 1, "first": "stamp 1500000000 ns",
        "advice": "look for two recorders or publishers of one topic",
    }  # fmt: skip
    assert fbench("log", "check", log, "--ignore", "CAL001", "--ignore", "TIM004").code == 0


@pytest.mark.parametrize("pipeline", ["lidar3d", "late3d"])
def test_builtin_pipelines_miss_nothing(fbench, log, pipeline):
    result = fbench("log", "check", log, "-p", pipeline, "--ignore", "CHK009", "--json")
    assert result.code == 0, result.out


def test_late3d_says_that_it_has_no_weights(fbench, log):
    result = fbench("log", "check", log, "-p", "late3d")
    assert result.code == 1
    assert "CHK009 camera: late3d can't use it: no weights" in result.out


def test_topics_leave_a_broken_sensor_out(fbench, tmp_path):
    log = write_log(tmp_path / "log.mcap", [*messages(), *truths()], Rig(rig().mounts, {}))
    assert fbench("log", "check", log).code == 1
    assert fbench("log", "check", log, "--topics", "!camera").code == 0


def test_timeout_is_that_of_the_replay(fbench, tmp_path):
    assert fbench("log", "check", "x.mcap", "--timeout-ms", "-1").code == 2


def test_exit_codes(fbench, log, tmp_path):
    assert fbench("log", "check", log, "-p", "lidar").code == 2
    assert fbench("log", "check", log, "--set", "a=b", "-p", "lidar3d").code == 2
    assert fbench("log", "check", log, "--ignore", "X").code == 2
    assert fbench("log", "check", tmp_path / "none.mcap").code == 3
    (tmp_path / "text.mcap").write_text("hello")
    result = fbench("log", "check", tmp_path / "text.mcap")
    assert result.code == 3
    assert result.err.count("\n") == 1


def test_demo_log_is_clean(fbench, tmp_path):
    from tests.city_log import write_city_log

    write_city_log(tmp_path / "city.mcap", seconds=3.0)
    assert fbench("log", "check", "city.mcap").code == 0


@pytest.mark.slow
def test_gaps_of_a_real_recording(fbench, shared):
    assert fbench("log", "import", "astyx", shared / "data" / "astyx", "-o", "astyx.mcap").code == 0
    result = fbench("log", "check", "astyx.mcap", "-p", "lidar3d", "--images", "--json")
    assert result.code == 1
    content = result.json()
    assert (content["frames"]["num_frames"], content["frames"]["num_complete"]) == (47, 47)
    assert len(content["frames"]["breaks"]) == 3
    assert {f["code"] for f in content["findings"] if f["severity"] != "info"} == {"TIM007", "CHK002"}
    assert fbench("log", "info", "astyx.mcap", "--json").json()["segments"] == 4


def test_recording_of_others_is_clean(fbench, shared):
    log = shared / "data" / "mcap" / "kitti_raw_12frames_ros2.mcap"
    assert fbench("log", "check", log).code == 0


def test_reference_that_is_not_there_is_a_usage_error(fbench, log):
    result = fbench("log", "check", log, "--reference", "lidr")
    assert result.code == 2
    assert result.err == "fbench: reference sensor 'lidr' isn't in the log; it has: camera, lidar, radar\n"


def test_a_changed_byte_outside_the_chunks_is_found(fbench, log):
    data = bytearray(log.read_bytes())
    data[25] ^= 1  # in the header: nothing needs it, but the checksum over the file covers it
    log.write_bytes(data)
    result = fbench("log", "check", log, "--json")
    assert result.code == 1
    assert [finding["code"] for finding in result.json()["findings"] if finding["severity"] != "info"] == ["LOG005"]


def test_a_part_that_is_missing_is_a_finding_and_lost_data(fbench, log):
    assert fbench("log", "convert", log, "-o", "parts", "--split-s", "0.1").code == 0
    parts = sorted(Path("parts").iterdir())
    parts[2].unlink()
    result = fbench("replay", "parts", "-p", "lidar3d", "-o", "run")
    assert result.code == 4
    assert f"LOG011 file of the recording is missing: 1 (first: parts: '{parts[2].name}')" in result.out
    assert "LOG011" in fbench("log", "check", "parts").out


def test_unread_topics_of_sensors_are_warned_of_by_name(fbench, tmp_path):
    """Not as one among others, which is information only."""
    channels = [("/gnss/fix", "sensor_msgs/msg/NavSatFix"), ("/lidar_packets", "acme_msgs/msg/Packets"),
                ("/radar_raw", "acme_msgs/msg/RadarScan")]  # fmt: skip
    log = foreign(*((topic, schema, "cdr", [bytes(8)]) for topic, schema in channels))(tmp_path)
    result = fbench("log", "check", log, "--ignore", "LOG006", "--ignore", "LOG003")
    assert result.code == 1
    warned = [line for line in result.out.splitlines() if line.startswith("warning")]
    assert [line.split("topic ")[1].split()[0] for line in warned] == ["'/lidar_packets'", "'/radar_raw'"]
    assert all(line.startswith("warning LOG013: ") for line in warned)
    assert "info LOG012" in result.out
    for command in (("log", "info", log), ("replay", log, "-p", "lidar3d", "--all-around")):
        said = fbench(*command)
        assert said.code == 0, said.err
        for topic in ("'/lidar_packets'", "'/radar_raw'"):
            assert f"isn't read: log.mcap: topic {topic} has type" in said.out
    assert fbench("log", "check", log, "--ignore", "LOG013", "--ignore", "LOG006", "--ignore", "LOG003").code == 0
