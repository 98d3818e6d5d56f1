"""One chunk of a ROS 1 bag with the index records behind it: its messages, checked against its index."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fbench.replay.arrays import Int64
from fbench.replay.errors import LogError
from fbench.replay.logs.container import Channel
from fbench.replay.logs.held import Held
from fbench.replay.logs.mcap.records import RecordError, check_size
from fbench.replay.logs.rosbag.bag1_records import Op, Record, connection, records, time_ns, uint, unpack

_COMPRESSIONS = ("none", "bz2", "lz4")
MAX_RECORDS = 2**18
"""Chunks of more records are refused: each takes some hundred bytes of memory, whatever its size in the file."""
_ENTRY = np.dtype([("s", "<u4"), ("ns", "<u4"), ("offset", "<u4")])


@dataclass(frozen=True)
class Block:
    """A chunk and the index records behind it, which are read at once."""

    offset: int
    """Of the chunk's record in the file, and the length of all [byte]."""
    length: int
    start_ns: int
    """Smallest and largest time of its messages."""
    end_ns: int
    counts: Mapping[int, int]
    """Messages of each connection."""
    is_indexed: bool
    """Whether the index records tell of every message."""


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
    """Unpack a block, and compare its messages with its index: with every one where `is_indexed`.

    Raises:
        RecordError: where it is damaged.
        LogError: where the chunk is larger than the limit, or too large beside those that `held` counts, or its
            compression is unknown.
    """
    rows = records(stored)
    chunk = next(rows, None)
    if chunk is None or chunk.op != Op.CHUNK:
        raise RecordError("no chunk where the index says")
    content = _parse(where, _unpacked(where, chunk, stored[chunk.data : chunk.stop], held))
    _compare(content, list(rows), stored, is_indexed)
    return content


def _unpacked(where: str, chunk: Record, data: memoryview, held: Held) -> memoryview:
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
    """Connection and times of its messages from an index record.

    Raises:
        RecordError: where it is damaged.
    """
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
