"""Logs of other programs: copied as they are, or decoded on request."""

import json

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap.writer import Writer as PlainWriter
from mcap_protobuf.writer import Writer
from tests.replay.logs import builders as b
from tests.replay.logs.convert.helpers import content, conversion, converted, digest, messages
from tests.replay.logs.test_foreign import JPEG, calibration, edge, packed

from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.open import open_container, open_log

FORMS = ["out.mcap", "out.parquet"]


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    """A camera, a LiDAR and a log topic in Foxglove schemas, as another program writes them."""
    path = tmp_path_factory.mktemp("foreign") / "log.mcap"
    with path.open("wb") as file, Writer(file) as writer:

        def put(log_ns, topic, message):
            writer.write_message(topic, message, log_time=log_ns, publish_time=log_ns + 1, sequence=log_ns * 3)

        put(1, "/tf_static", FrameTransforms(transforms=[edge("base_link", "lidar"), edge("base_link", "cam")]))
        put(1, "/cam/info", calibration())
        for i in range(2, 12):
            put(i, "/cam/image", CompressedImage(frame_id="cam", data=JPEG, format="jpeg"))
            put(i, "/points", packed([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], [(i, 2, 3)]))
            put(i, "/rosout", Log(message=f"line {i}"))
            put(i, "/tf", FrameTransforms(transforms=[edge("map", "base_link", (i, 0, 0))]))
    return path


def strange(path):
    """Topics that fbench knows nothing of: no schema, JSON, an empty payload, stamps beyond an int64."""
    with path.open("wb") as file:
        writer = PlainWriter(file)
        writer.start()
        schema = writer.register_schema("Thing", "jsonschema", b'{"type": "object"}')
        plain = writer.register_channel("/bytes", "x-own", 0, {"a": "b", "": "ü"})
        things = writer.register_channel("/things", "json", schema)
        again = writer.register_channel("/things", "json", schema, {"version": "2"})
        writer.add_message(plain, 2**64 - 1, b"\x00\xff", 2**64 - 2, 2**32 - 1)
        for i in range(20):
            writer.add_message((things, again)[i % 2], 7, json.dumps({"i": i}).encode(), i, i)
            writer.add_message(plain, i, b"", 0, 0)
        writer.finish()
    return path


@pytest.mark.parametrize("name", FORMS)
def test_bytes_stay_bytes(tmp_path, foreign, name):
    out = converted(foreign, tmp_path / name)
    assert messages(out) == messages(foreign)
    assert (content(out), digest(out)) == (content(foreign), digest(foreign))
    assert messages(converted(out, tmp_path / "back.mcap")) == messages(foreign)


@pytest.mark.parametrize("name", FORMS)
def test_what_nobody_understands_stays_as_it_is(tmp_path, name):
    path = strange(tmp_path / "strange.mcap")
    out = converted(path, tmp_path / name)
    assert messages(out) == messages(path)
    assert messages(converted(out, tmp_path / "back.mcap")) == messages(path)
    assert b.read(out)[0].info.log_id == b.read(path)[0].info.log_id


def test_own_and_foreign_topics_in_one_log(tmp_path, drive):
    path = tmp_path / "both.mcap"
    from fbench.replay.logs.container import Channel, Schema
    from fbench.replay.logs.containers.mcap.write import RawMcapWriter

    source = open_container(drive, FaultLog())
    writer = RawMcapWriter(path, source.header)
    for entry in source.entries(frozenset(source.channels)):
        writer.add(source.channels[entry.channel], entry.log_ns, entry.publish_ns, entry.sequence, entry.data)
        writer.add(Channel("/notes", "json", Schema("Note", "", b"")), entry.log_ns, 3, 4, b"{}")
    writer.close()
    there = converted(path, tmp_path / "both.parquet")
    kinds = {c.topic: c.encoding for c in open_container(there, FaultLog()).channels.values()}
    assert kinds["/notes"] == "json"
    assert kinds["/top/points"] == "fbench"
    assert messages(converted(there, tmp_path / "back.mcap")) == messages(path)
    assert digest(there) == digest(drive)


@pytest.mark.parametrize("spoil", ["payload", "sequence", "metadata", "transform"])
def test_what_looks_like_ours_but_is_not_stays_as_it_is(tmp_path, drive, spoil):
    """An older fbench, or somebody who writes the same metadata: what wouldn't come back exactly stays bytes."""
    from dataclasses import replace

    from fbench.replay.logs.containers.mcap.write import RawMcapWriter

    path = tmp_path / "odd.mcap"
    source = open_container(drive, FaultLog())
    writer = RawMcapWriter(path, source.header)
    for i, entry in enumerate(source.entries(frozenset(source.channels))):
        channel, sequence, data = source.channels[entry.channel], entry.sequence, bytes(entry.data)
        is_late_scan = entry.topic == "/front/points" and i > 40
        if spoil == "payload" and is_late_scan:
            data = data + b"\xf8\x07\x01"  # an unknown field
        elif spoil == "sequence" and is_late_scan:
            sequence = 9
        elif spoil == "metadata" and entry.topic == "/front/points":
            channel = replace(channel, metadata={**channel.metadata, "note": "x"})
        elif spoil == "transform" and entry.topic == "/tf":
            data = data + b"\xf8\x07\x01"
        writer.add(channel, entry.log_ns, entry.publish_ns, sequence, data)
    writer.close()
    there = converted(path, tmp_path / "odd.parquet")
    kinds = {c.topic: c.encoding for c in open_container(there, FaultLog()).channels.values()}
    assert kinds["/tf" if spoil == "transform" else "/front/points"] == "protobuf"
    assert kinds["/top/points"] == "fbench"
    assert messages(converted(there, tmp_path / "back.mcap")) == messages(path)
    assert (content(there), digest(there)) == (content(path), digest(path))


@pytest.mark.parametrize("name", FORMS)
def test_decoded_logs_replay_as_before(tmp_path, foreign, name):
    result, faults = conversion(foreign, tmp_path / name, decode=True)
    assert not faults.num_lost
    assert dict(result.left_out) == {"/rosout": 10, "/tf": 10}
    assert digest(result.path) == digest(foreign)
    assert content(result.path) == content(foreign)
    assert set(result.messages) >= {"/cam/image", "/points"}
    assert all(role.is_own for role in open_log(result.path, FaultLog()).roles.values())


def test_decoding_an_own_log_keeps_it(tmp_path, drive):
    assert content(converted(drive, tmp_path / "out.mcap", decode=True)) == content(drive)


@pytest.mark.parametrize("name", FORMS)
def test_decoded_parts(tmp_path, foreign, name):
    out = converted(foreign, tmp_path / name, decode=True, start="5ns", end="7ns", topics=("/points",))
    reader, _ = b.read(out)
    assert [(m.sensor, m.log_ns) for m in reader.messages()] == [("lidar", 5), ("lidar", 6)]
    assert set(reader.rig.mounts) == {"lidar"}


def test_a_log_without_rig_is_not_decoded(tmp_path):
    path = tmp_path / "log.mcap"
    with path.open("wb") as file, Writer(file) as writer:
        writer.write_message("/points", packed([("x", "<f4"), ("y", "<f4"), ("z", "<f4")], [(1, 2, 3)], frame=""))
    with pytest.raises(LogError, match="sensor 'points' has no transform to the body"):
        converted(path, tmp_path / "out.mcap", decode=True)
    assert messages(converted(path, tmp_path / "copy.mcap")) == messages(path)


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize(
    ("patterns", "expected"),
    [
        (("/rosout",), {"/tf_static", "/tf", "/cam/info", "/rosout"}),
        (("lidar", "/ros*"), {"/tf_static", "/tf", "/cam/info", "/rosout", "/points"}),
        (("!/rosout", "!cam"), {"/tf_static", "/tf", "/cam/info", "/points"}),
        (("/points", "!/points"), None),
    ],
)
def test_topics_that_nobody_understands_can_be_chosen(tmp_path, foreign, name, patterns, expected):
    out = converted(foreign, tmp_path / name, topics=patterns)
    whole = messages(foreign)
    wanted = expected or {"/tf_static", "/tf", "/cam/info"}
    assert messages(out) == [m for m in whole if m[0].topic in wanted]


@pytest.mark.parametrize("name", FORMS)
def test_sensors_that_are_left_out_leave_the_rig(tmp_path, drive, name):
    for source in (drive, converted(drive, tmp_path / "drive.parquet")):
        reader, _ = b.read(converted(source, tmp_path / f"{source.suffix}-{name}", topics=("!cam",)))
        assert set(reader.rig.mounts) == {"front", "top"}
        assert not reader.rig.cameras
        assert len(list(reader.truths())) == 40
        assert "cam" not in reader.num_messages


def test_patterns_that_fit_nothing(tmp_path, drive):
    with pytest.raises(ConfigError, match=r"--topics /tpo/points: fits no topic or sensor; did you mean '/top/points'"):
        converted(drive, tmp_path / "out.mcap", topics=("/tpo/points",))
    assert list(tmp_path.iterdir()) == []


def test_points_of_a_decoded_log_are_columns(tmp_path, foreign):
    import pyarrow.parquet as pq

    converted(foreign, tmp_path / "out.parquet", decode=True)
    table = pq.read_table(tmp_path / "out.parquet" / "points.parquet")
    assert np.frombuffer(table["xyz"][0].as_py(), "<f4").tolist() == [2, 2, 3]
