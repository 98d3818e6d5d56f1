"""Cutting by time."""

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from mcap_protobuf.writer import Writer
from tests.replay.logs import builders as b
from tests.replay.logs.convert.helpers import content, conversion, converted, digest, messages
from tests.replay.logs.convert.test_round_trip import changing, rig
from tests.replay.logs.other_forms import chunks
from tests.replay.logs.test_foreign import calibration, edge, packed

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.rig import RigChange

START = 1_000_000_000
FORMS = ["out.mcap", "out.parquet"]


@pytest.mark.parametrize("name", FORMS)
def test_what_is_before_a_cut_isnt_read(tmp_path, name):
    """Apart from its beginning, which has the rig: so a part of a large log takes as long as the part is."""
    whole = b.write(tmp_path / "whole.mcap", b.sequence(60), chunk_size=3000)
    good = converted(whole, tmp_path / f"good-{name}", start="1.5")
    data, places = bytearray(whole.read_bytes()), chunks(whole.read_bytes())
    for at, length in places[len(places) // 6 : len(places) // 3]:
        data[at + 60 : at + length] = bytes(length - 60)
    whole.write_bytes(data)
    assert digest(converted(whole, tmp_path / name, start="1.5")) == digest(good)
    _, faults = conversion(whole, tmp_path / f"all-{name}")
    assert faults.num_lost


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize(
    ("start", "end", "first", "stop"),
    [
        ("0.5", "1.0", START + 500_000_000, START + 1_000_000_000),
        ("0.5", None, START + 500_000_000, 2**63),
        (None, "1.0", 0, START + 1_000_000_000),
        ("1500000005ns", "1.7", START + 500_000_005, START + 1_700_000_000),
        ("0", "5ns", 0, 0),
    ],
)
def test_a_part_is_the_slice_of_the_whole(tmp_path, drive, name, start, end, first, stop):
    """From the first measurement on, half-open, by the time of recording."""
    reader, _ = b.read(drive)
    expected = [b.canonical(m) for m in reader.messages() if first <= m.log_ns < stop]
    truths = [b.canonical(t) for t in reader.truths() if first <= t.log_ns < stop]
    if not expected:
        with pytest.raises(ConfigError, match=r"empty; the first measurement is at 1000000000ns"):
            converted(drive, tmp_path / name, start=start, end=end)
        return
    part, _ = b.read(converted(drive, tmp_path / name, start=start, end=end))
    assert [b.canonical(m) for m in part.messages()] == expected
    assert [b.canonical(t) for t in part.truths()] == truths
    assert b.canonical(part.rig) == b.canonical(reader.rig)
    assert part.info.log_id == reader.info.log_id


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize(("start", "mounts"), [(40, 0), (50, 5), (60, 5), (80, 8), (95, 8)])
def test_the_rig_in_force_at_the_cut_survives(tmp_path, name, start, mounts):
    path = changing(tmp_path / "log.mcap")
    for source in (path, converted(path, tmp_path / "log.parquet")):
        out = converted(source, tmp_path / f"{source.suffix}-{name}", start=f"{start}ns")
        assert b.canonical(b.read(out)[0].rig) == b.canonical(rig(mounts))
        slice_ = [m for m in b.read(path)[0].messages() if m.log_ns >= start]
        if isinstance(slice_[0], RigChange):
            slice_ = slice_[1:]
        assert [b.canonical(m) for m in b.read(out)[0].messages()] == [b.canonical(m) for m in slice_]


def test_parts_of_both_forms_are_equal(tmp_path, drive):
    there = converted(drive, tmp_path / "drive.parquet")
    for source in (drive, there):
        for name in FORMS:
            converted(source, tmp_path / f"{source.suffix}-{name}", start="0.7", end="1.3")
    logs = [tmp_path / f"{suffix}-{name}" for suffix in (".mcap", ".parquet") for name in FORMS]
    assert len({digest(log) for log in logs}) == 1
    assert all(content(log) == content(logs[0]) for log in logs)
    assert messages(logs[0]) == messages(logs[2])


def foreign(path):
    """Transforms of several publishers on one topic, some of them again; a calibration with every image."""
    cloud = packed([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], [(1, 2, 3)])
    with path.open("wb") as file, Writer(file) as writer:

        def put(log_ns, topic, message):
            writer.write_message(topic, message, log_time=log_ns, publish_time=log_ns + 1)

        put(1, "/tf_static", FrameTransforms(transforms=[edge("base_link", "a"), edge("base_link", "b", (1, 0, 0))]))
        put(2, "/tf_static", FrameTransforms(transforms=[edge("base_link", "lidar", (2, 0, 0))]))
        put(3, "/tf_static", FrameTransforms(transforms=[edge("base_link", "a", (3, 0, 0))]))
        for i in range(10, 20):
            put(i, "/camera_info", calibration())
            put(i, "/tf", FrameTransforms(transforms=[edge("map", "odom", (i, 0, 0))]))
            put(i, "/points", cloud)
        put(30, "/tf_static", FrameTransforms(transforms=[edge("base_link", "lidar", (9, 0, 0))]))
    return path


@pytest.mark.parametrize("name", FORMS)
def test_of_a_foreign_log_the_last_messages_that_tell_the_rig_survive(tmp_path, name):
    path = foreign(tmp_path / "log.mcap")
    whole, out = messages(path), messages(converted(path, tmp_path / name, start="15ns", end="17ns"))
    before = [(m[0].topic, m[1]) for m in out if m[1] < 15]
    assert before == [("/tf_static", 1), ("/tf_static", 2), ("/tf_static", 3)]
    assert [m for m in out if m[1] >= 15] == [m for m in whole if 15 <= m[1] < 17]
    assert all(m in whole for m in out)
    out = messages(converted(path, tmp_path / f"late-{name}", start="25ns"))
    assert [(m[0].topic, m[1]) for m in out] == [*before, ("/camera_info", 19), ("/tf_static", 30)]
    mount = b.read(tmp_path / name)[0].rig.mounts["lidar"]
    np.testing.assert_array_equal(mount.translation_m, [2, 0, 0])


@pytest.mark.parametrize(
    ("start", "end", "message"),
    [
        ("5", "4", "--from 5 --to 4: the range is empty"),
        ("soon", None, "--from soon: expected seconds"),
        (None, "-1", "--to -1: expected seconds"),
        ("nan", None, "--from nan: expected seconds"),
        ("100", None, "no message from 101000000000ns to the end; see fbench log info"),
        ("1.5", "1500000000ns", "empty; the first measurement is at 1000000000ns"),
    ],
)
@pytest.mark.parametrize("name", FORMS)
def test_ranges_that_make_no_sense(tmp_path, drive, start, end, message, name):
    with pytest.raises(ConfigError, match=message):
        converted(drive, tmp_path / name, start=start, end=end)
    assert list(tmp_path.iterdir()) == []
