"""Bags of ROS 1 against the library `rosbags`."""

import struct

import numpy as np
import pytest
from tests.replay.logs.containers.rosbag import builders as b

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.container import Channel, Schema
from fbench.replay.logs.containers.rosbag.bag1 import Ros1Bag


def opened(path):
    faults = FaultLog()
    return Ros1Bag(path, faults), faults


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
@pytest.mark.parametrize("chunk_bytes", [1, 1000, 10**6])
def test_reads_what_rosbags_reads(tmp_path, compression, chunk_bytes):
    messages = b.rows()
    path = b.write_bag1(tmp_path / "a.bag", messages, compression, chunk_bytes)
    bag, faults = opened(path)
    got = b.everything(bag)
    assert sorted(got) == b.read_bag1(path)
    order = {data: at for at, (_, _, data) in enumerate(messages)}
    expected = sorted(messages, key=lambda row: (row[1], b.TOPICS[row[0]][0], order[row[2]]))
    assert [(number, log_ns, data) for log_ns, _, number, data in got] == expected
    assert faults.counts == {"LOG006": 1}
    assert faults.places["LOG006"] == ["a.bag: 300 messages, ROS 1 bags have no checksums"]


def test_channels_are_connections(tmp_path):
    bag, _ = opened(b.write_bag1(tmp_path / "a.bag", b.rows()))
    schema = Schema("std_msgs/String", "ros1msg", b.DEFINITION.encode())
    assert bag.channels[0] == Channel("/b", "ros1", schema, {"callerid": "/node0", "md5sum": "0" * 32})
    assert [channel.topic for _, channel in sorted(bag.channels.items())] == ["/b", "/a", "/b", "/c"]
    assert bag.header is None
    assert not bag.rigs


def test_counts_and_times_are_those_of_the_messages(tmp_path):
    messages = b.rows()
    bag, _ = opened(b.write_bag1(tmp_path / "a.bag", messages))
    for number in range(len(b.TOPICS)):
        stamps = sorted(log_ns for row, log_ns, _ in messages if row == number)
        assert bag.counts[number] == len(stamps)
        np.testing.assert_array_equal(bag.log_times()[number], stamps)


def test_only_the_wanted_channels(tmp_path):
    bag, _ = opened(b.write_bag1(tmp_path / "a.bag", b.rows()))
    assert {entry.channel for entry in bag.entries(frozenset({1, 3, 99}))} == {1, 3}


def test_bag_without_messages(tmp_path):
    bag, faults = opened(b.write_bag1(tmp_path / "a.bag", []))
    assert b.everything(bag) == []
    assert b.counted(faults) == {}


def with_index_pos(path, index_pos):
    """The bag as it is while it is recorded: its header tells nothing, and there is no index."""
    data = path.read_bytes()
    at = data.index(b"index_pos=") + len(b"index_pos=")
    (known,) = struct.unpack_from("<Q", data, at)
    path.write_bytes(data[:at] + struct.pack("<Q", index_pos) + data[at + 8 : known])
    return path


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_bag_that_was_never_closed(tmp_path, compression):
    path = b.write_bag1(tmp_path / "a.bag", b.rows(), compression)
    expected = b.read_bag1(path)
    bag, faults = opened(with_index_pos(path, 0))
    assert sorted(b.everything(bag)) == expected
    assert b.counted(faults) == {"LOG003": 1}
    assert faults.places["LOG003"] == ["a.bag: bag was never closed"]
    assert bag.log_times() is None
    assert sum(bag.counts.values()) == 300


def chunk_ends(path):
    """Offset behind each chunk, with how many messages lie before; from a bag that is whole."""
    bag, _ = opened(path)
    data = path.read_bytes()
    blocks = {entry.block for entry in bag.entries(frozenset(bag.channels))}
    ends = []
    for block in sorted(blocks):
        (header,) = struct.unpack_from("<I", data, block)
        (length,) = struct.unpack_from("<I", data, block + 4 + header)
        ends.append((block + 8 + header + length, block))
    return ends


@pytest.mark.slow
@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_truncation_delivers_the_whole_chunks_before(tmp_path, compression):
    path = b.write_bag1(tmp_path / "a.bag", b.rows(), compression)
    data = path.read_bytes()
    ends = chunk_ends(path)
    bag, _ = opened(path)
    entries = list(bag.entries(frozenset(bag.channels)))
    cut_path = tmp_path / "cut.bag"
    first = ends[0][1]
    for cut in np.linspace(first, len(data) - 1, 133).astype(int):
        cut_path.write_bytes(data[:cut])
        cut_bag, faults = opened(cut_path)
        whole = {block for end, block in ends if end <= cut}
        expected = [(e.log_ns, e.topic, e.channel, bytes(e.data)) for e in entries if e.block in whole]
        assert b.everything(cut_bag) == expected
        last = max((log_ns for log_ns, *_ in expected), default="none")
        assert faults.counts["LOG002"] == 1
        place = faults.places["LOG002"][0]
        assert place.endswith(f", last good stamp {last}")
        at = int(place.split("byte ")[1].split(",")[0])
        assert at <= cut
        assert not faults.counts["LOG004"]


def test_truncation_within_the_header(tmp_path):
    path = b.write_bag1(tmp_path / "a.bag", b.rows(10))
    data = path.read_bytes()
    for cut in range(4109):
        if cut % 97 and cut > 40:
            continue
        path.write_bytes(data[:cut])
        with pytest.raises(LogError, match=r"not a ROS 1 bag|header of the bag|of version"):
            opened(path)


def flipped(data, bit):
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << (bit % 8)
    return bytes(changed)


@pytest.mark.slow
@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_single_bit_flips(tmp_path, compression):
    """Payloads have no checksum, so that flips in those of uncompressed chunks can't be seen; all else is."""
    messages = b.rows(60)
    path = b.write_bag1(tmp_path / "a.bag", messages, compression)
    data = path.read_bytes()
    good = b.everything(opened(path)[0])
    channels = opened(path)[0].channels
    rng = np.random.Generator(np.random.Philox(5))
    harmless = range(13 * 8 + 80 * 8, 4109 * 8)  # the padding of the first record
    for bit in rng.integers(0, len(data) * 8, 500 // 3 + 1).tolist():
        path.write_bytes(flipped(data, bit))
        try:
            bag, faults = opened(path)
            got = b.everything(bag)
        except LogError:
            continue
        if b.counted(faults) or bit in harmless:
            continue
        assert [row[:3] for row in got] == [row[:3] for row in good], bit
        assert dict(bag.channels) == dict(channels), bit
        if compression == "bz2":  # which has checksums
            assert got == good


@pytest.mark.slow
def test_flips_in_the_index_lose_nothing_silently(tmp_path):
    path = b.write_bag1(tmp_path / "a.bag", b.rows(60))
    data = path.read_bytes()
    good = b.everything(opened(path)[0])
    at = data.index(b"index_pos=") + len(b"index_pos=")
    (index_pos,) = struct.unpack_from("<Q", data, at)
    rng = np.random.Generator(np.random.Philox(6))
    for bit in rng.integers(index_pos * 8, len(data) * 8, 330).tolist():
        path.write_bytes(flipped(data, bit))
        bag, faults = opened(path)
        got = b.everything(bag)
        assert (got == good and dict(bag.channels) == dict(opened_channels(data, path))) or b.counted(faults), bit


def opened_channels(data, path):
    whole = path.with_name("whole.bag")
    if not whole.exists():
        whole.write_bytes(data)
    return opened(whole)[0].channels


def test_damaged_chunk_costs_only_itself(tmp_path):
    path = b.write_bag1(tmp_path / "a.bag", b.rows(), "bz2")
    bag, _ = opened(path)
    entries = list(bag.entries(frozenset(bag.channels)))
    victim = sorted({entry.block for entry in entries})[2]
    data = bytearray(path.read_bytes())
    data[victim + 200] ^= 8
    path.write_bytes(data)
    bag, faults = opened(path)
    assert b.everything(bag) == [(e.log_ns, e.topic, e.channel, bytes(e.data)) for e in entries if e.block != victim]
    assert b.counted(faults) == {"LOG004": 1}
    b.everything(bag)
    assert b.counted(faults) == {"LOG004": 1}  # once, however often it is read
    assert faults.places["LOG004"][0].startswith(f"a.bag: byte {victim}: bz2 data are damaged")


def test_damaged_frame_of_a_chunk_is_stepped_over_by_the_index(tmp_path):
    path = b.write_bag1(tmp_path / "a.bag", b.rows())
    bag, _ = opened(path)
    entries = list(bag.entries(frozenset(bag.channels)))
    victim = sorted({entry.block for entry in entries})[2]
    data = bytearray(path.read_bytes())
    data[victim : victim + 4] = b"\xff\xff\xff\x7f"
    path.write_bytes(data)
    bag, faults = opened(path)
    assert b.everything(bag) == [(e.log_ns, e.topic, e.channel, bytes(e.data)) for e in entries if e.block != victim]
    assert b.counted(faults) == {"LOG003": 1, "LOG004": 1}


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda data: data.replace(b"V2.0", b"V1.2"), r"ROS bag of version 1\.2; fbench reads 2\.0"),
        (lambda data: b"PAR1" + data, r"not a ROS 1 bag \(looks like Parquet"),
        (lambda data: b"", r"not a ROS 1 bag \(looks like an empty file\)"),
        (lambda data: data.replace(b"index_pos=", b"index_poz="), "header of the bag at byte 13 can't be read"),
        (lambda data: data.replace(b"compression=none", b"compression=lzma"), "unknown compression 'lzma'"),
    ],
)
def test_what_cannot_be_read(tmp_path, change, match):
    path = b.write_bag1(tmp_path / "a.bag", b.rows(30))
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(LogError, match=match):
        b.everything(opened(path)[0])


def field(name, value):
    return struct.pack("<I", len(name) + 1 + len(value)) + name + b"=" + value


def record(header, data=b""):
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def bag_header(**more):
    fields = {"op": b"\x03", "index_pos": bytes(8), "conn_count": bytes(4), "chunk_count": bytes(4), **more}
    return b"#ROSBAG V2.0\n" + record(b"".join(field(name.encode(), value) for name, value in fields.items()))


def chunk(data, compression=b"none", size=None):
    size = struct.pack("<I", len(data) if size is None else size)
    return record(field(b"op", b"\x05") + field(b"compression", compression) + field(b"size", size), data)


def connection(number, topic=b"/a"):
    header = field(b"op", b"\x07") + field(b"conn", struct.pack("<I", number)) + field(b"topic", topic)
    return record(header, field(b"type", b"a/B") + field(b"md5sum", b"*") + field(b"message_definition", b"\xff"))


def message(number, seconds, data=b"x"):
    time = field(b"time", struct.pack("<II", seconds, 0))
    return record(field(b"op", b"\x02") + field(b"conn", struct.pack("<I", number)) + time, data)


def made(tmp_path, *parts):
    path = tmp_path / "a.bag"
    path.write_bytes(b"".join(parts))
    return path


def test_encrypted(tmp_path):
    path = made(tmp_path, bag_header(encryptor=b"rosbag/AesCbcEncryptor"))
    with pytest.raises(LogError, match=r"the bag is encrypted; decrypt it first"):
        opened(path)


def test_definition_and_topic_need_not_be_utf8(tmp_path):
    bag, faults = opened(made(tmp_path, bag_header(), chunk(connection(7, b"/\xff") + message(7, 1))))
    assert b.everything(bag) == [(10**9, "/\\xff", 7, b"x")]
    assert bag.channels[7].schema.data == b"\xff"
    assert b.counted(faults) == {"LOG003": 1, "LOG010": 1}


def test_messages_of_an_unknown_connection(tmp_path):
    bag, faults = opened(made(tmp_path, bag_header(), chunk(connection(7) + message(8, 1) + message(7, 2))))
    assert b.everything(bag) == [(2 * 10**9, "/a", 7, b"x")]
    assert faults.places["LOG008"] == ["a.bag: messages on unknown connection 8"]


def test_connection_that_is_defined_twice(tmp_path):
    parts = chunk(connection(7) + message(7, 1)), chunk(connection(7, b"/b") + message(7, 2))
    bag, faults = opened(made(tmp_path, bag_header(), *parts))
    assert {topic for _, topic, _, _ in b.everything(bag)} == {"/a"}
    assert "connection 7 is defined twice, as topic '/b' here" in faults.places["LOG004"][0]


def test_chunk_that_was_never_closed(tmp_path):
    """Recorders write 0 as the length of a chunk first, and the messages behind it."""
    opening = chunk(b"", size=0)
    bag, faults = opened(made(tmp_path, bag_header(), chunk(connection(7) + message(7, 1)), opening, message(7, 2)))
    assert b.everything(bag) == [(10**9, "/a", 7, b"x")]
    assert b.counted(faults) == {"LOG002": 1, "LOG003": 1}


def test_index_may_point_at_the_connection_before_the_message(tmp_path):
    content = connection(7) + message(7, 1)
    header = field(b"op", b"\x04") + field(b"ver", struct.pack("<I", 1)) + field(b"conn", struct.pack("<I", 7))
    index = record(header + field(b"count", struct.pack("<I", 1)), struct.pack("<III", 1, 0, 0))
    bag, faults = opened(made(tmp_path, bag_header(), chunk(content), index))
    assert len(b.everything(bag)) == 1
    assert b.counted(faults) == {"LOG003": 1}


@pytest.mark.parametrize("garbage", [b"\x00", b"\xff" * 40, bytes(40), record(field(b"op", b"\x09"))])
def test_garbage_between_records(tmp_path, garbage):
    bag, faults = opened(made(tmp_path, bag_header(), chunk(connection(7) + message(7, 1)), garbage))
    assert len(b.everything(bag)) == 1
    assert 1 <= faults.num_lost <= 2
    at = len(bag_header()) + len(chunk(connection(7) + message(7, 1)))
    assert any(f"byte {at}" in place for places in faults.places.values() for place in places)
