"""Good recordings of other recorders are clean: what their format can't have is no problem of theirs."""

import pytest
from tests.replay.check.logs import checked, found, problems
from tests.replay.setup import drive as d


def recording():
    """A LiDAR and a camera with their calibration, jittered as by a real recorder; 3 s."""
    log = d.Drive()
    mounts = [("base_link", "lidar", (0, 0, 1.8), (0, 0, 0, 1)), ("base_link", "optical", (0, 0, 1.5), d.OPTICAL)]
    log.add("/tf_static", d.START_NS, d.transforms(mounts))
    for i, ns in d.steps(30, 100):
        at = ns + i * 7919 % 3 * d.MS
        log.add("/lidar/points", at + 60 * d.MS, d.points("lidar", at, 200 + i))
        log.add("/camera/image_raw", at + 20 * d.MS, d.jpeg("optical", at))
        log.add("/camera/camera_info", at + 21 * d.MS, d.info("optical", at))
    return log


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_bags_of_ros1(tmp_path, compression):
    result = checked(recording().write_bag1(tmp_path / "drive.bag", compression))
    assert problems(result) == []
    assert result.frames.num_complete == 30
    one = found(result, "LOG006")
    assert (one.severity, one.text) == ("info", "the format has no checksums, so damage could go unnoticed")
    assert one.advice == "nothing; fbench log convert writes a log with them"


def test_a_folder_of_bags(tmp_path):
    for part in range(2):
        log = recording()
        log.rows = log.rows[:1] + log.rows[1 + 45 * part : 46 + 45 * part]
        log.write_bag1(tmp_path / f"drive_{part}.bag")
    assert problems(checked(tmp_path)) == []


def test_recordings_of_rosbag2(tmp_path):
    assert problems(checked(recording().write_bag2(tmp_path / "drive"))) == []


def test_a_format_that_can_have_checksums_should_have_them(tmp_path):
    bare = recording().write_bag2(tmp_path / "drive", "mcap")
    assert problems(checked(bare)) == [("LOG003", ""), ("LOG006", "")]


def test_a_bag_whose_index_is_lost_is_a_finding(tmp_path):
    path = recording().write_bag1(tmp_path / "drive.bag")
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    assert {"LOG002", "LOG003"} <= {code for code, _ in problems(checked(path))}
