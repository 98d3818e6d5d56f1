"""One MCAP file as a stream of entries in canonical order.

https://mcap.dev/spec#message-index-op0x07: channel, length of an array, and in it log time and offset of each message.
No checksum covers them, so they count only where they agree with the index of the file, which one covers.
"""

import os
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from struct import Struct
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import DataEnd

from fbench.replay.contracts.errors import DecodeError, LimitError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Array, Int64
from fbench.replay.data.rig import Rig
from fbench.replay.logs import container as header
from fbench.replay.logs.container import Channel, Entry, LogHeader, Schema, merge_blocks
from fbench.replay.logs.containers.limits import Held, crc32, looks_like
from fbench.replay.logs.containers.mcap.index import Block, Index, NoIndexError, has_end, read_index
from fbench.replay.logs.containers.mcap.records import (
    HEAD,
    MAGIC,
    Chunk,
    RecordError,
    check_size,
    parse_chunk,
    parse_record,
    records,
    unpack,
)
from fbench.replay.logs.containers.mcap.walk import MESSAGE, check_compression, walk

MAX_SHARE = 0.005  # Message indexes that are a larger share of the file aren't read, unless they are small:
SMALL = 1024 * 1024  # [byte]
_ARRAY = struct.Struct("<HI")
_WHERE = "message indexes"
_ENTRY = np.dtype([("log_ns", "<u8"), ("offset", "<u8")])


class _MismatchError(Exception):
    """The message indexes can't be trusted."""


@dataclass
class _Stream:
    """The entries of one channel, and whose chunks they are."""

    data: bytearray = field(default_factory=bytearray)
    blocks: list[int] = field(default_factory=list)
    nums: list[int] = field(default_factory=list)


def read_log_times(file: int, size: int, index: Index) -> Mapping[int, Int64] | None:
    """Log times of each channel's messages, ascending; `None` where the indexes are absent, too large or wrong.

    Args:
        file: Descriptor of the open file.
        size: Of the file [byte].
        index: As the file's summary says.
    """
    lengths = [block.index_length for block in index.blocks]
    if not index.is_stored or sum(lengths) > max(MAX_SHARE * size, SMALL):
        return None
    try:
        return _check(_read(file, index.blocks), index)
    except (_MismatchError, RecordError, LimitError):
        return None


def _read(file: int, blocks: Sequence[Block]) -> dict[int, _Stream]:
    streams: dict[int, _Stream] = {}
    for number, block in enumerate(blocks):
        # Not through a buffer, which would read more than what is wanted.
        data = memoryview(os.pread(file, block.index_length, block.offset + block.length))
        if len(data) != block.index_length:
            raise _MismatchError
        found = [_add(streams, number, opcode, data[start:stop]) for opcode, start, stop in records(data, _WHERE)]
        if sorted(found) != sorted(block.channels or ()):
            raise _MismatchError
    return streams


def _add(streams: dict[int, _Stream], block: int, opcode: int, content: memoryview) -> int:
    """Take one record; returns its channel."""
    if opcode != Opcode.MESSAGE_INDEX or len(content) < _ARRAY.size:
        raise _MismatchError
    channel, length = _ARRAY.unpack_from(content)
    if length != len(content) - _ARRAY.size or length % _ENTRY.itemsize:
        raise _MismatchError
    stream = streams.setdefault(channel, _Stream())
    stream.data += content[_ARRAY.size :]
    stream.blocks.append(block)
    stream.nums.append(length // _ENTRY.itemsize)
    return int(channel)


def _check(streams: Mapping[int, _Stream], index: Index) -> dict[int, Int64]:
    if {id_: sum(s.nums) for id_, s in streams.items()} != {id_: n for id_, n in index.counts.items() if n}:
        raise _MismatchError
    bounds = np.array([(b.start_ns, b.end_ns, b.size or 0) for b in index.blocks], np.uint64).reshape(-1, 3)
    return {id_: _times(stream, bounds) for id_, stream in sorted(streams.items())}


def _times(stream: _Stream, bounds: Array) -> Int64:
    entries = np.frombuffer(bytes(stream.data), _ENTRY)
    start, end, size = bounds[np.repeat(stream.blocks, stream.nums)].T
    log_ns = entries["log_ns"]
    if not np.all((start <= log_ns) & (log_ns <= end) & (entries["offset"] + HEAD.size <= size)):
        raise _MismatchError
    if len(log_ns) and int(log_ns.max()) > np.iinfo(np.int64).max:
        raise _MismatchError
    return np.sort(log_ns.astype(np.int64), kind="stable")


_PIECE = 8 * 1024 * 1024
_END = HEAD.size + 4
_FOOTER = Struct("<Q12x")  # Content of the footer: where the summary starts, and what isn't needed here


def is_whole(file: BinaryIO, size: int) -> bool | None:
    """Compare all bytes before the record DataEnd, which lies right before the summary, with the checksum in it.

    Args:
        file: With a summary.
        size: Of the file [byte].

    Returns:
        `None` where there is none.
    """
    file.seek(size - len(MAGIC) - _FOOTER.size)
    (summary_start,) = _FOOTER.unpack(file.read(_FOOTER.size))
    at = summary_start - _END
    file.seek(max(0, at))
    end = file.read(_END)
    if at < 0 or HEAD.unpack_from(end) != (Opcode.DATA_END, 4):
        return None
    try:
        stored = parse_record(DataEnd.read, end[HEAD.size :]).data_section_crc
    except RecordError:
        return None
    if stored == 0:
        return None
    file.seek(0)
    crc, left = 0, at
    while left and (piece := file.read(min(_PIECE, left))):
        crc, left = crc32(piece, crc), left - len(piece)
    return bool(crc == stored)


_NUM_KEPT, _MAX_KEPT = 4, 16 * 1024 * 1024
"""The first blocks of so many passes are kept, unless they are larger [byte]: looking at the first message of each
topic reads the same few blocks again and again."""

MAX_ENTRIES = 2**19
"""A block with more messages that are wanted is refused: each takes hundreds of bytes once it is told apart."""


class McapFile:
    """Finds and reads the messages of a file; implements `Container`.

    Each fault is counted once, however often it is met. Raises LogError where the file can't be opened or isn't MCAP.
    """

    def __init__(self, path: Path, faults: FaultLog) -> None:
        self.path = path
        self._faults = faults
        self._kept: tuple[tuple[int, memoryview], ...] = ()
        with self._open() as file:
            self.index = self._read_index(file, os.fstat(file.fileno()).st_size)
        for damage in self.index.damage:
            faults.add("LOG004", f"{path.name}: {damage}")
        self.header = self._read_header()
        self.channels = self._channels()
        self.counts = self.index.counts
        self.rigs: Sequence[tuple[int, Rig]] = ()

    def _read_header(self) -> LogHeader | None:
        record = self.index.metadata.get(header.NAME)
        if record is None:
            return None
        try:
            return header.read_header(record.metadata)
        except DecodeError as error:
            self.once("LOG004", (0,), f"metadata record '{header.NAME}': {error}")
            return None

    def log_times(self) -> Mapping[int, Int64] | None:
        """Log times from the message indexes behind the chunks, where these are small."""
        with self._open() as file:
            return read_log_times(file.fileno(), os.fstat(file.fileno()).st_size, self.index)

    def entries(self, channels: frozenset[int]) -> Iterator[Entry]:
        """All messages of these channels in canonical order; damaged blocks are skipped and counted."""
        return self._entries(channels, self.index.blocks)

    def entries_from(self, channels: frozenset[int], start_ns: int) -> Iterator[Entry]:
        """All messages of these channels from a log time on; no block that ends before is read."""
        blocks = [block for block in self.index.blocks if block.end_ns >= start_ns]
        return (entry for entry in self._entries(channels, blocks) if entry.log_ns >= start_ns)

    def _entries(self, channels: frozenset[int], blocks: Sequence[Block]) -> Iterator[Entry]:
        wanted = [b for b in blocks if b.channels is None or not b.channels.isdisjoint(channels)]
        first = min(wanted, key=lambda b: (b.start_ns, b.offset), default=None)
        held = Held()
        with self._open() as file:
            yield from merge_blocks(wanted, lambda block: self._load(file, held, block, channels, block is first))

    def verify(self) -> None:
        """Compare the checksum over the data section, where it wasn't done to find the messages."""
        with self._open() as file:
            if self.index.is_stored and is_whole(file, os.fstat(file.fileno()).st_size) is False:
                self.once("LOG005", (0,), "bytes outside the chunks have changed")

    def once(self, code: str, key: tuple[str | int, ...], where: str) -> None:
        """Count a fault unless `key`, the place, was counted under the same code before."""
        self._faults.once(code, (str(self.path), *key), f"{self.path.name}: {where}")

    def _channels(self) -> dict[int, Channel]:
        found: dict[int, Channel] = {}
        for id_, channel in self.index.channels.items():
            schema = self.index.schemas.get(channel.schema_id)
            if schema is None and channel.schema_id:
                self.once("LOG008", (channel.topic,), f"topic '{channel.topic}' names schema {channel.schema_id}")
            plain = None if schema is None else Schema(_escape(schema.name), _escape(schema.encoding), schema.data)
            topic, encoding = _escape(channel.topic), _escape(channel.message_encoding)
            metadata = {_escape(key): _escape(value) for key, value in channel.metadata.items()}
            found[id_] = Channel(topic, encoding, plain, metadata)
            if topic != channel.topic or (schema is not None and plain is not None and plain.name != schema.name):
                self.once("LOG010", (id_,), f"channel {id_}, topic '{topic}'")
        return found

    @contextmanager
    def _open(self) -> Iterator[BinaryIO]:
        try:
            with self.path.open("rb") as file:
                yield file
        except OSError as error:
            raise LogError(f"{self.path}: can't be read ({error.strerror})") from error

    def _read_index(self, file: BinaryIO, size: int) -> Index:
        if file.read(len(MAGIC)) != MAGIC:
            raise LogError(f"{self.path}: not a log (looks like {looks_like(file)})", "LOG001")
        whole = has_end(file, size)
        if not whole:
            return walk(file, self.path.name, size, whole, self._faults)
        try:
            return read_index(file, size, self.path.name)
        except NoIndexError as reason:
            self._faults.add("LOG003", f"{self.path.name}: {reason}")
            return walk(file, self.path.name, size, whole, self._faults)

    def _load(
        self, file: BinaryIO, held: Held, block: Block, channels: frozenset[int], is_first: bool
    ) -> Iterable[Entry]:
        where = f"{self.path.name}: byte {block.offset}"
        try:
            kept = next((data for offset, data in self._kept if offset == block.offset), None)
            data = self._read(file, held, where, block) if kept is None else kept
            if is_first and kept is None and len(data) <= _MAX_KEPT:
                self._kept = (*self._kept[1 - _NUM_KEPT :], (block.offset, data))
            found = self._sort(where, self._parse(where, block, data, channels))
            return held.hold(found, len(found), len(data), block.length)
        except RecordError as error:
            self.once("LOG004", (block.offset,), f"byte {block.offset}: {error}")
            return []

    def _read(self, file: BinaryIO, held: Held, where: str, block: Block) -> memoryview:
        check_size(where, max(block.length, block.size or 0))
        file.seek(block.offset)
        content = memoryview(file.read(block.length))
        if len(content) != block.length:  # the file has become shorter
            raise RecordError(f"{len(content)} bytes instead of {block.length}")
        return self._unpack(held, where, block, content) if block.is_chunk else content

    def _sort(self, where: str, entries: Iterator[Entry]) -> list[Entry]:
        found = list(islice(entries, MAX_ENTRIES + 1))
        if len(found) > MAX_ENTRIES:
            raise LimitError(f"{where}: holds more than {MAX_ENTRIES} messages", "LIM001")
        found.sort()
        return found

    def _unpack(self, held: Held, where: str, block: Block, content: memoryview) -> memoryview:
        if HEAD.unpack_from(content) != (Opcode.CHUNK, block.length - HEAD.size):
            raise RecordError("no chunk of the indexed length")
        chunk = parse_chunk(content[HEAD.size :])
        _compare(block, chunk)
        check_size(where, chunk.size)
        check_compression(where, chunk.compression)
        if not chunk.crc and block.size is not None:  # else it was counted when the file was walked
            self.once("LOG006", (block.offset,), f"chunk at byte {block.offset}")
        held.require(where, chunk.size, block.length)
        return unpack(chunk, where)

    def _parse(self, where: str, block: Block, data: memoryview, channels: frozenset[int]) -> Iterator[Entry]:
        for opcode, start, stop in records(data, where):
            if opcode != Opcode.MESSAGE:
                continue
            if stop - start < MESSAGE.size:
                raise RecordError("message is too short")
            channel, sequence, log_ns, publish_ns = MESSAGE.unpack_from(data, start)
            if log_ns < block.start_ns:
                raise RecordError(f"holds a message of {log_ns}, before its start {block.start_ns}")
            if channel in channels:
                topic = self.channels[channel].topic
                payload = data[start + MESSAGE.size : stop]
                yield Entry(log_ns, topic, 0, block.offset, start, channel, sequence, publish_ns, payload)
            elif channel not in self.channels:
                self.once("LOG008", (channel,), f"messages on unknown channel {channel}")


def _escape(text: str) -> str:
    """Show the bytes of a text that aren't UTF-8 as `\\xff`."""
    if text.isascii():  # not copied, as there can be millions
        return text
    return text.encode(errors="surrogateescape").decode(errors="backslashreplace")


def _compare(block: Block, chunk: Chunk) -> None:
    """A chunk's header has no checksum; the index has one, so that what it says is what counts."""
    expected = (block.start_ns, block.end_ns, block.size, block.stored, block.compression)
    got = (chunk.start_ns, chunk.end_ns, chunk.size, len(chunk.data), chunk.compression)
    if block.size is not None and expected != got:
        raise RecordError("chunk isn't the one of the index")
