"""ROS bags become MCAP and Parquet, byte for byte."""

import pytest
from tests.replay.logs.containers.rosbag.builders import rows, write_bag1, write_bag2
from tests.replay.logs.convert.helpers import conversion, converted, messages

FORMS = ["out.mcap", "out.parquet"]


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize("compression", ["none", "lz4", "bz2"])
def test_ros_1(tmp_path, name, compression):
    path = write_bag1(tmp_path / "log.bag", rows(), compression)
    out = converted(path, tmp_path / name)
    assert len(messages(out)) == 300
    assert messages(out) == messages(path)
    assert messages(converted(out, tmp_path / "back.mcap")) == messages(path)


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize(("storage", "mode"), [("sqlite3", "none"), ("sqlite3", "message"), ("mcap", "none")])
def test_ros_2(tmp_path, name, storage, mode):
    path = write_bag2(tmp_path / "bag", rows(), 8, mode, storage)
    out = converted(path, tmp_path / name)
    assert len(messages(out)) == 300
    assert messages(out) == messages(path)


def test_only_a_part_of_a_bag(tmp_path):
    path = write_bag1(tmp_path / "log.bag", rows())
    whole = messages(path)
    middle = whole[len(whole) // 2][1]
    result, _ = conversion(path, tmp_path / "out.mcap", start=f"{middle}ns", topics=("/b", "!/a"))
    assert messages(result.path) == [m for m in whole if m[0].topic == "/b" and m[1] >= middle]
