"""Index of a ROS 1 bag and its chunks, checked against each other."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import BinaryIO, NamedTuple

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import Int64
from fbench.replay.logs.container import Channel
from fbench.replay.logs.containers.limits import Held, looks_like
from fbench.replay.logs.containers.mcap.records import RecordError, check_size
from fbench.replay.logs.containers.rosbag.bag1_records import Op, Record, connection, read_record, records, unpack

MAX_RECORDS = 2**18
"""Chunks of more records are refused: each takes some hundred bytes of memory, whatever its size in the file."""
_ENTRY = np.dtype([("s", "<u4"), ("ns", "<u4"), ("offset", "<u4")])
_MAX_INDEX = 100 * MAX_RECORDS
MAGIC = b"#ROSBAG V2.0\n"


class Block(NamedTuple):
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
    compression = chunk.fields.get(b"compression", b"").decode("utf-8", "backslashreplace")
    if compression not in ("none", "bz2", "lz4"):
        raise LogError(f"{where}: unknown compression '{compression}'; fbench reads bz2, lz4 and none", "LOG007")
    size = chunk.uint(b"size")
    check_size(where, size)
    held.require(where, size, chunk.stop - chunk.data)
    data = unpack(compression, stored[chunk.data : chunk.stop], size)
    messages: list[Message] = []
    connections: list[tuple[int, Channel]] = []
    for record in records(data):
        if len(messages) + len(connections) == MAX_RECORDS:
            raise LogError(f"{where}: holds more than the limit of {MAX_RECORDS} records", "LIM001")
        op = record.op
        if op == Op.MESSAGE:
            log_ns = record.time_ns(b"time")
            messages.append(Message(log_ns, record.uint(b"conn"), record.start, record.data, record.stop))
        elif op == Op.CONNECTION:
            connections.append(connection(record, data[record.data : record.stop]))
        else:
            raise RecordError(f"chunk holds a record of type {op}")
    _compare(data, messages, list(rows), stored, is_indexed)
    return Content(data, messages, connections)


def _compare(
    data: memoryview, messages: Sequence[Message], index: Sequence[Record], stored: memoryview, is_indexed: bool
) -> None:
    """The messages' headers and the index say the same, or one of them is damaged: there is no checksum."""
    if sum(record.stop - record.data for record in index) > len(messages) * _ENTRY.itemsize:
        raise RecordError("index tells of more messages than there are")
    # Offset of the message that an offset of the index means: some recorders give that of connections before it.
    starts: dict[int, int] = {}
    at = 0
    for message in messages:
        starts |= {at + record.start: message.start for record in records(data[at : message.start])}
        starts[message.start] = message.start
        at = message.stop
    found: set[tuple[int, int, int]] = set()
    for record in index:
        number, times, offsets = _index_columns(record, stored)
        keys = zip(times.tolist(), offsets.tolist(), strict=True)
        found |= {(log_ns, number, starts.get(offset, -1)) for log_ns, offset in keys}
    expected = {(m.log_ns, m.connection, m.start) for m in messages}
    if not found <= expected or (is_indexed and found != expected):
        raise RecordError("messages and their index contradict each other")


def _index_columns(record: Record, stored: memoryview) -> tuple[int, Int64, Int64]:
    """Connection, times and offsets of its messages from an index record. Raises RecordError where it is damaged."""
    if record.op != Op.INDEX_DATA or record.uint(b"ver") != 1:
        raise RecordError("no index of version 1 behind the chunk")
    if record.stop - record.data != record.uint(b"count") * _ENTRY.itemsize:
        raise RecordError("index behind the chunk is of another length")
    rows = np.frombuffer(stored[record.data : record.stop], _ENTRY)
    return record.uint(b"conn"), rows["s"].astype(np.int64) * 1_000_000_000 + rows["ns"], rows["offset"]


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
    """The bag has no index that can be trusted, with the reason; it must be walked. `chunks` are the offsets of chunks
    that it told nevertheless, ascending.
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
        counts = record.uint(b"conn_count"), record.uint(b"chunk_count")
        return BagHeader(record.uint(b"index_pos", 8), *counts, record.stop)
    except RecordError as error:
        raise LogError(f"{path}: header of the bag at byte {len(MAGIC)} can't be read ({error})") from error


def read_index(file: BinaryIO, header: BagHeader, size: int) -> Index:
    """Read the index. Raises NoIndexError where it is absent, damaged or contradicts itself."""
    if not header.stop <= header.index_pos <= size:
        raise NoIndexError("bag was never closed" if header.index_pos == 0 else "index is cut off")
    chunks: list[int] = []
    try:
        channels, infos = _read_section(file, header.index_pos, size)
        chunks = [info.offset for info in infos]
        if (len(channels), len(infos)) != (header.num_connections, header.num_chunks):
            raise NoIndexError("index is incomplete", chunks)
        borders = [*chunks, header.index_pos]
        if borders[0] != header.stop or any(stop <= start for start, stop in pairwise(borders)):
            raise NoIndexError("index contradicts itself", chunks)
        blocks = [_block(file, info, stop, channels) for info, stop in zip(infos, borders[1:], strict=True)]
    except RecordError as error:
        raise NoIndexError(f"index is damaged: {error}", chunks) from error
    return Index([block for block in blocks if block.counts], channels)


def _read_section(file: BinaryIO, start: int, size: int) -> tuple[Mapping[int, Channel], Sequence[_Info]]:
    check_size(f"index at byte {start}", size - start)
    file.seek(start)
    stored = memoryview(file.read(size - start))
    channels: dict[int, Channel] = {}
    infos: list[_Info] = []
    for record in records(stored):
        data = stored[record.data : record.stop]
        if record.op == Op.CONNECTION:
            number, channel = connection(record, data)
            if channels.setdefault(number, channel) != channel:
                raise RecordError(f"connection {number} is defined twice")
        elif record.op == Op.CHUNK_INFO:
            if record.uint(b"ver") != 1 or len(data) != 8 * record.uint(b"count"):
                raise RecordError("it has another version or length")
            counts = dict(np.frombuffer(data, "<u4").reshape(-1, 2).tolist())
            times = record.time_ns(b"start_time"), record.time_ns(b"end_time")
            infos.append(_Info(record.uint(b"chunk_pos", 8), *times, counts))
        else:
            raise RecordError(f"it holds a record of type {record.op}")
    return channels, sorted(infos, key=lambda info: info.offset)


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
    yield from (_index_columns(record, stored)[:2] for record in records(stored))


def _block(file: BinaryIO, info: _Info, stop: int, channels: Mapping[int, Channel]) -> Block:
    found = list(index_records(file, info.offset, stop))
    counts = {number: len(times) for number, times in found if len(times)}
    times = np.concatenate([times for _, times in found]) if counts else np.array([info.start_ns, info.end_ns])
    expected = {number: count for number, count in info.counts.items() if count}
    if expected != counts or (info.start_ns, info.end_ns) != (times.min(), times.max()):
        raise RecordError(f"that of the chunk at byte {info.offset} contradicts it")
    if not counts.keys() <= channels.keys():
        raise RecordError("connections are missing")
    return Block(info.offset, stop - info.offset, info.start_ns, info.end_ns, counts, is_indexed=True)
