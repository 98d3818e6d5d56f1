"""Index of a ROS 1 bag and its chunks, checked against each other."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import BinaryIO, NamedTuple

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import Int64
from fbench.replay.logs.container import Channel
from fbench.replay.logs.containers.limits import Held, looks_like
from fbench.replay.logs.containers.mcap.records import RecordError, check_size
from fbench.replay.logs.containers.rosbag.bag1_records import (
    Op,
    Record,
    connection,
    read_record,
    records,
    time_ns,
    uint,
    unpack,
)

_COMPRESSIONS = ("none", "bz2", "lz4")
MAX_RECORDS = 2**18
"""Chunks of more records are refused: each takes some hundred bytes of memory, whatever its size in the file."""
_ENTRY = np.dtype([("s", "<u4"), ("ns", "<u4"), ("offset", "<u4")])


@dataclass(frozen=True)
class Block:
    """A chunk and the index records behind it, which are read at once."""

    offset: int  # Of the chunk's record in the file, and the length of all [byte]
    length: int
    start_ns: int  # Smallest and largest time of its messages
    end_ns: int
    counts: Mapping[int, int]  # Messages of each connection
    is_indexed: bool  # Whether the index records tell of every message


class Message(NamedTuple):
    """A message of a chunk; `data` to `stop` is its payload in the unpacked chunk."""

    log_ns: int
    connection: int
    start: int
    data: int
    stop: int


@dataclass(frozen=True)
class Content:
    """What a block holds."""

    data: memoryview
    messages: Sequence[Message]
    connections: Sequence[tuple[int, Channel]]

    def block(self, offset: int, length: int, is_indexed: bool) -> Block:
        """Describe it; it must have messages."""
        times = [message.log_ns for message in self.messages]
        counts = Counter(message.connection for message in self.messages)
        return Block(offset, length, min(times), max(times), counts, is_indexed)


def parse_block(where: str, stored: memoryview, is_indexed: bool, held: Held) -> Content:
    """Unpack a block, and compare its messages with its index: with every one where `is_indexed`. Raises RecordError
    where it is damaged. Raises LogError where the chunk is larger than the limit, or too large beside those that `held`
    counts, or its compression is unknown.
    """
    rows = records(stored)
    chunk = next(rows, None)
    if chunk is None or chunk.op != Op.CHUNK:
        raise RecordError("no chunk where the index says")
    content = _parse(where, _unpack(where, chunk, stored[chunk.data : chunk.stop], held))
    _compare(content, list(rows), stored, is_indexed)
    return content


def _unpack(where: str, chunk: Record, data: memoryview, held: Held) -> memoryview:
    compression = chunk.fields.get(b"compression", b"").decode("utf-8", "backslashreplace")
    if compression not in _COMPRESSIONS:
        raise LogError(f"{where}: unknown compression '{compression}'; fbench reads bz2, lz4 and none", "LOG007")
    size = uint(chunk.fields, b"size", 4)
    check_size(where, size)
    held.require(where, size, len(data))
    return unpack(compression, data, size)


def _parse(where: str, data: memoryview) -> Content:
    messages: list[Message] = []
    connections: list[tuple[int, Channel]] = []
    for record in records(data):
        if len(messages) + len(connections) == MAX_RECORDS:
            raise LogError(f"{where}: holds more than the limit of {MAX_RECORDS} records", "LIM001")
        op = record.op
        if op == Op.MESSAGE:
            log_ns, number = time_ns(record.fields, b"time"), uint(record.fields, b"conn", 4)
            messages.append(Message(log_ns, number, record.start, record.data, record.stop))
        elif op == Op.CONNECTION:
            connections.append(connection(record.fields, data[record.data : record.stop]))
        else:
            raise RecordError(f"chunk holds a record of type {op}")
    return Content(data, messages, connections)


def index_times(record: Record, stored: memoryview) -> tuple[int, Int64]:
    """Connection and times of its messages from an index record. Raises RecordError where it is damaged."""
    number, rows = _index_rows(record, stored)
    return number, rows["s"].astype(np.int64) * 1_000_000_000 + rows["ns"]


def _index_rows(record: Record, stored: memoryview) -> tuple[int, np.ndarray[tuple[int], np.dtype[np.void]]]:
    if record.op != Op.INDEX_DATA or uint(record.fields, b"ver", 4) != 1:
        raise RecordError("no index of version 1 behind the chunk")
    if record.stop - record.data != uint(record.fields, b"count", 4) * _ENTRY.itemsize:
        raise RecordError("index behind the chunk is of another length")
    return uint(record.fields, b"conn", 4), np.frombuffer(stored[record.data : record.stop], _ENTRY)


def _index_keys(record: Record, stored: memoryview) -> list[tuple[int, int, int]]:
    number, times = index_times(record, stored)
    offsets = _index_rows(record, stored)[1]["offset"]
    return [(log_ns, number, offset) for log_ns, offset in zip(times.tolist(), offsets.tolist(), strict=True)]


def _compare(content: Content, index: Sequence[Record], stored: memoryview, is_indexed: bool) -> None:
    """The messages' headers and the index say the same, or one of them is damaged: there is no checksum."""
    if sum(record.stop - record.data for record in index) > len(content.messages) * _ENTRY.itemsize:
        raise RecordError("index tells of more messages than there are")
    starts = _starts(content)
    found = {
        (log_ns, number, starts.get(offset, -1))
        for record in index for log_ns, number, offset in _index_keys(record, stored)
    }  # fmt: skip
    expected = {(m.log_ns, m.connection, m.start) for m in content.messages}
    if not found <= expected or (is_indexed and found != expected):
        raise RecordError("messages and their index contradict each other")


def _starts(content: Content) -> Mapping[int, int]:
    """Offset of the message that an offset of the index means: some recorders give that of connections before it."""
    starts: dict[int, int] = {}
    at = 0
    for message in content.messages:
        for record_start in _between(content.data, at, message.start):
            starts[record_start] = message.start
        starts[message.start] = message.start
        at = message.stop
    return starts


def _between(data: memoryview, start: int, stop: int) -> list[int]:
    return [start + record.start for record in records(data[start:stop])]


MAGIC = b"#ROSBAG V2.0\n"
_MAX_INDEX = 100 * MAX_RECORDS


class BagHeader(NamedTuple):
    """The first record of a bag."""

    index_pos: int  # Where the index starts; 0: the recorder never closed the bag
    num_connections: int
    num_chunks: int
    stop: int  # Where the chunks start


@dataclass(frozen=True)
class Index:
    """All blocks of a bag, with the channels of their messages."""

    blocks: Sequence[Block]
    channels: Mapping[int, Channel]
    is_complete: bool = True  # False where the file was walked


class NoIndexError(Exception):
    """The bag has no index that can be trusted, with the reason; it must be walked.

    `chunks` are the offsets of chunks that it told nevertheless, ascending.
    """

    def __init__(self, reason: str, chunks: Sequence[int] = ()) -> None:
        super().__init__(reason)
        self.chunks = chunks


class _Info(NamedTuple):
    """What the index says of a chunk."""

    offset: int
    start_ns: int
    end_ns: int
    counts: Mapping[int, int]


@dataclass
class _Section:
    channels: dict[int, Channel] = field(default_factory=dict)
    infos: list[_Info] = field(default_factory=list)


def read_header(file: BinaryIO, path: str, size: int) -> BagHeader:
    """Read magic and first record of a bag. Raises LogError where it isn't a bag of version 2.0, is encrypted, or the
    record is damaged.
    """
    file.seek(0)
    magic = file.read(len(MAGIC))
    if magic.startswith(b"#ROSBAG V") and magic != MAGIC:
        version = magic[9:].split(b"\n")[0].decode("ascii", "backslashreplace")
        raise LogError(f"{path}: ROS bag of version {version}; fbench reads 2.0 (`rosbag migrate` converts)")
    if magic != MAGIC:
        raise LogError(f"{path}: not a ROS 1 bag (looks like {looks_like(file)})")
    try:
        record = read_record(file, len(MAGIC), size)
        if record is None or record.op != Op.BAG_HEADER:
            raise RecordError("it is missing or cut off")
        if record.fields.get(b"encryptor"):
            raise LogError(f"{path}: the bag is encrypted; decrypt it first (`rosbag decrypt`)")
        counts = uint(record.fields, b"conn_count", 4), uint(record.fields, b"chunk_count", 4)
        return BagHeader(uint(record.fields, b"index_pos", 8), *counts, record.stop)
    except RecordError as error:
        raise LogError(f"{path}: header of the bag at byte {len(MAGIC)} can't be read ({error})") from error


def read_index(file: BinaryIO, header: BagHeader, size: int) -> Index:
    """Read the index. Raises NoIndexError where it is absent, damaged or contradicts itself."""
    if not header.stop <= header.index_pos <= size:
        raise NoIndexError("bag was never closed" if header.index_pos == 0 else "index is cut off")
    try:
        section = _section(file, header.index_pos, size)
    except RecordError as error:
        raise NoIndexError(f"index is damaged: {error}") from error
    infos = sorted(section.infos)
    chunks = [info.offset for info in infos]
    if (len(section.channels), len(infos)) != (header.num_connections, header.num_chunks):
        raise NoIndexError("index is incomplete", chunks)
    borders = [*chunks, header.index_pos]
    if borders[0] != header.stop or any(stop <= start for start, stop in pairwise(borders)):
        raise NoIndexError("index contradicts itself", chunks)
    try:
        blocks = [_block(file, info, stop, section) for info, stop in zip(infos, borders[1:], strict=True)]
    except RecordError as error:
        raise NoIndexError(f"index is damaged: {error}", chunks) from error
    return Index([block for block in blocks if block.counts], section.channels)


def index_records(file: BinaryIO, start: int, stop: int) -> Iterator[tuple[int, Int64]]:
    """Connection and times from each index record behind the chunk that lies at `start`; `stop` is where they end.
    Raises RecordError where chunk or index is damaged.
    """
    chunk = read_record(file, start, stop)
    if chunk is None or chunk.op != Op.CHUNK:
        raise RecordError(f"no chunk at byte {start}")
    if stop - chunk.stop > _MAX_INDEX:
        raise RecordError(f"index behind the chunk at byte {start} has more than {_MAX_INDEX} bytes")
    file.seek(chunk.stop)
    stored = memoryview(file.read(stop - chunk.stop))
    yield from (index_times(record, stored) for record in records(stored))


def _block(file: BinaryIO, info: _Info, stop: int, section: _Section) -> Block:
    found = list(index_records(file, info.offset, stop))
    counts = {number: len(times) for number, times in found if len(times)}
    times = np.concatenate([times for _, times in found]) if counts else np.array([info.start_ns, info.end_ns])
    expected = {number: count for number, count in info.counts.items() if count}
    if expected != counts or (info.start_ns, info.end_ns) != (times.min(), times.max()):
        raise RecordError(f"that of the chunk at byte {info.offset} contradicts it")
    if not counts.keys() <= section.channels.keys():
        raise RecordError("connections are missing")
    return Block(info.offset, stop - info.offset, info.start_ns, info.end_ns, counts, is_indexed=True)


def _section(file: BinaryIO, start: int, size: int) -> _Section:
    check_size(f"index at byte {start}", size - start)
    file.seek(start)
    stored = memoryview(file.read(size - start))
    section = _Section()
    for record in records(stored):
        data = stored[record.data : record.stop]
        if record.op == Op.CONNECTION:
            number, channel = connection(record.fields, data)
            if section.channels.setdefault(number, channel) != channel:
                raise RecordError(f"connection {number} is defined twice")
        elif record.op == Op.CHUNK_INFO:
            section.infos.append(_info(record, data))
        else:
            raise RecordError(f"it holds a record of type {record.op}")
    return section


def _info(record: Record, data: memoryview) -> _Info:
    if uint(record.fields, b"ver", 4) != 1 or len(data) != 8 * uint(record.fields, b"count", 4):
        raise RecordError("it has another version or length")
    pairs = np.frombuffer(data, "<u4").reshape(-1, 2).tolist()
    times = time_ns(record.fields, b"start_time"), time_ns(record.fields, b"end_time")
    return _Info(uint(record.fields, b"chunk_pos", 8), *times, dict(pairs))
