"""Log times from message indexes: those of the messages, or none."""

import struct

import pytest
from mcap.opcode import Opcode
from mcap.writer import IndexType
from tests.replay.logs.builders import sequence, write
from tests.replay.logs.other_forms import HEAD, NO_SUMMARY, layout, rewrite, shuffled_topics

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.container import Channel, LogHeader
from fbench.replay.logs.containers.mcap.file import McapFile
from fbench.replay.logs.containers.mcap.index import parse_chunk_index
from fbench.replay.logs.containers.mcap.records import RecordError
from fbench.replay.logs.containers.mcap.write import RawMcapWriter


@pytest.fixture
def log(tmp_path):
    return write(tmp_path / "log.mcap", sequence(), chunk_size=3000)


def by_reading(path):
    file = McapFile(path, FaultLog())
    found = {id_: [] for id_ in file.channels}
    for entry in file.entries(frozenset(file.channels)):
        found[entry.channel].append(entry.log_ns)
    return found


def from_index(path):
    times = McapFile(path, FaultLog()).log_times()
    return None if times is None else {id_: found.tolist() for id_, found in times.items()}


def test_they_are_those_of_the_messages(log):
    times = from_index(log)
    assert times == by_reading(log)
    assert sum(map(len, times.values())) == 5 * 40


@pytest.mark.parametrize("order", [list, shuffled_topics])
def test_they_are_ascending_whatever_the_order_in_the_file(log, tmp_path, order):
    other = rewrite(log, tmp_path / "other.mcap", order, chunk_size=2000)
    assert from_index(other) == by_reading(other)


@pytest.mark.parametrize("how", [NO_SUMMARY, {"index_types": IndexType.CHUNK}, {"use_chunking": False}])
def test_none_without_an_index(log, tmp_path, how):
    assert from_index(rewrite(log, tmp_path / "other.mcap", **how)) is None


def damaged(log, change):
    """Apply `change(data, start, length)` to the first message index."""
    data = bytearray(log.read_bytes())
    _, at, length = next(row for row in layout(bytes(data)) if row[0] == Opcode.MESSAGE_INDEX)
    change(data, at, length)
    log.write_bytes(data)


def put(fmt, offset, value):
    def change(data, at, length):
        struct.pack_into(fmt, data, at + offset, value)

    return change


@pytest.mark.parametrize(
    "change",
    [
        put("<B", 0, Opcode.METADATA),
        put("<Q", 1, 2**60),
        put("<Q", 1, 1),
        put("<H", HEAD.size, 999),
        put("<I", HEAD.size + 2, 7),
        put("<I", HEAD.size + 2, 2**31),
        put("<Q", HEAD.size + 6, 0),
        put("<Q", HEAD.size + 6, 2**64 - 1),
        put("<Q", HEAD.size + 14, 2**40),
    ],
    ids=["type", "long", "short", "channel", "uneven", "large", "early", "late", "offset"],
)
def test_none_where_they_cannot_be_right(log, change):
    damaged(log, change)
    assert from_index(log) is None


@pytest.mark.slow
def test_none_where_they_would_be_much_to_read(tmp_path):
    path = tmp_path / "small.mcap"
    writer = RawMcapWriter(path, LogHeader("many"), "none")
    for i in range(70_000):
        writer.add(Channel("/imu", "x"), i, i, 0, b"")
    writer.close()
    file = McapFile(path, FaultLog())
    assert file.log_times() is None
    assert file.index.span_ns == (0, 69_999)


def test_chunk_index_is_read_as_the_library_reads_it(log):
    from io import BytesIO

    from mcap.data_stream import ReadDataStream
    from mcap.records import ChunkIndex

    data = log.read_bytes()
    rows = [(at, length) for opcode, at, length in layout(data) if opcode == Opcode.CHUNK_INDEX]
    assert len(rows) > 3
    for at, length in rows:
        content = data[at + HEAD.size : at + length]
        theirs, ours = ChunkIndex.read(ReadDataStream(BytesIO(content))), parse_chunk_index(memoryview(content))
        assert ours == (
            theirs.chunk_start_offset, theirs.chunk_length, theirs.message_start_time, theirs.message_end_time,
            frozenset(theirs.message_index_offsets), True, theirs.uncompressed_size, theirs.compressed_size,
            theirs.compression, theirs.message_index_length,
        )  # fmt: skip


@pytest.mark.parametrize("bad", [b"", b"\x00" * 50, b"\xff" * 80])
def test_chunk_index_that_does_not_fit_together(bad):
    with pytest.raises(RecordError, match="chunk index"):
        parse_chunk_index(memoryview(bad))


def test_chunk_index_that_is_cut_off_is_refused(log):
    data = log.read_bytes()
    _, at, length = next(row for row in layout(data) if row[0] == Opcode.CHUNK_INDEX)
    content = data[at + HEAD.size : at + length]
    for stop in range(len(content)):
        with pytest.raises(RecordError):
            parse_chunk_index(memoryview(content[:stop]))
