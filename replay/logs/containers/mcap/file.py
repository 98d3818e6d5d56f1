"""One MCAP file as a stream of entries in canonical order."""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from struct import Struct
from typing import BinaryIO, cast

import numpy as np
from mcap.opcode import Opcode

from fbench.replay.contracts.errors import DecodeError, LimitError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Array, Int64
from fbench.replay.logs import container as header
from fbench.replay.logs.container import Channel, Entry, Schema, merge_blocks
from fbench.replay.logs.containers.limits import Held, StoredLog, crc32, looks_like
from fbench.replay.logs.containers.mcap import records
from fbench.replay.logs.containers.mcap.index import Block, Index, NoIndexError, has_end, read_index
from fbench.replay.logs.containers.mcap.records import HEAD, MAGIC, MESSAGE, RecordError
from fbench.replay.logs.containers.mcap.walk import walk
from fbench.replay.logs.containers.rosbag.zstd import is_packed, unpack_message

MAX_SHARE = 0.005  # Message indexes that are a larger share of the file aren't read, unless they are small:
SMALL = 1024 * 1024  # [byte]
_ARRAY = Struct("<HI")
_ENTRY = np.dtype([("log_ns", "<u8"), ("offset", "<u8")])
_PIECE = 8 * 1024 * 1024
_FOOTER = Struct("<Q12x")  # Content of the footer: where the summary starts, and what isn't needed here
_END = Struct(HEAD.format + "I")  # The whole record DataEnd, whose content is a checksum
_NUM_KEPT, _MAX_KEPT = 4, 16 * 1024 * 1024
"""The first blocks of so many passes are kept, unless they are larger [byte]: looking at the first message of each
topic reads the same few blocks again and again."""
MAX_ENTRIES = 2**19
"""A block with more messages that are wanted is refused: each takes hundreds of bytes once it is told apart."""


class McapFile(StoredLog):
    """Finds and reads the messages of a file; implements `Container`.

    Each fault is counted once, however often it is met. `has_packed`: rosbag2 compressed the messages one by one with
    zstd; without it, such blocks are found by how their messages begin. Raises LogError where the file can't be opened
    or isn't MCAP.
    """

    def __init__(self, path: Path, faults: FaultLog, has_packed: bool = False) -> None:
        super().__init__(path, faults)
        self._has_packed = has_packed
        self._kept: tuple[tuple[int, memoryview], ...] = ()
        with self._open() as file:
            self.index = self._read_index(file, os.fstat(file.fileno()).st_size)
        for damage in self.index.damage:
            faults.add("LOG004", f"{path.name}: {damage}")
        if (record := self.index.metadata.get(header.NAME)) is not None:
            try:
                self.header = header.read_header(record.metadata)
            except DecodeError as error:
                self.once("LOG004", (0,), f"metadata record '{header.NAME}': {error}")
        self.channels = self._channels()
        self.counts = self.index.counts
        self._cdr = frozenset(id_ for id_, channel in self.channels.items() if channel.encoding == "cdr")

    def log_times(self) -> Mapping[int, Int64] | None:
        """Log times from the message indexes behind the chunks; `None` where they are absent, too large or wrong.

        https://mcap.dev/spec#message-index-op0x07: channel, length of an array, and in it log time and offset of each
        message. No checksum covers them, so they count only where they agree with the index of the file, which one
        covers.
        """
        with self._open() as file:
            share = MAX_SHARE * os.fstat(file.fileno()).st_size
            if not self.index.is_stored or sum(b.index_length for b in self.index.blocks) > max(share, SMALL):
                return None
            try:
                return _read_log_times(file.fileno(), self.index)
            except (RecordError, LimitError):
                return None

    def entries(self, channels: frozenset[int], start_ns: int | None = None) -> Iterator[Entry]:
        """All messages of these channels from a log time on in canonical order, no block that ends before is read;
        damaged blocks and messages are skipped and counted.
        """
        blocks = [
            block
            for block in self.index.blocks
            if (start_ns is None or block.end_ns >= start_ns)
            and (block.channels is None or not block.channels.isdisjoint(channels))
        ]
        first = min(blocks, key=lambda b: (b.start_ns, b.offset), default=None)
        held = Held()
        with self._open() as file:
            entries = merge_blocks(blocks, lambda block: self._load(file, held, block, channels, block is first))
            if start_ns is not None:
                entries = (entry for entry in entries if entry.log_ns >= start_ns)
            yield from self._unpack(entries) if self._has_packed else entries

    def verify(self) -> None:
        """Compare all bytes before the record DataEnd, which lies right before the summary, with the checksum in it,
        where there is one and it wasn't done to find the messages.
        """
        if not self.index.is_stored:
            return
        with self._open() as file:
            file.seek(-len(MAGIC) - _FOOTER.size, os.SEEK_END)
            at = _FOOTER.unpack(file.read(_FOOTER.size))[0] - _END.size
            file.seek(max(0, at))
            *head, expected = _END.unpack(file.read(_END.size))
            if at < 0 or head != [Opcode.DATA_END, 4] or not expected:
                return
            file.seek(0)
            crc = 0
            while at and (piece := file.read(min(_PIECE, at))):
                crc, at = crc32(piece, crc), at - len(piece)
        if crc != expected:
            self.once("LOG005", (0,), "bytes outside the chunks have changed")

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

    def _read_index(self, file: BinaryIO, size: int) -> Index:
        if file.read(len(MAGIC)) != MAGIC:
            raise LogError(f"{self.path}: not a log (looks like {looks_like(file)})", "LOG001")
        whole = has_end(file, size)
        if whole:
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
            data = next((data for offset, data in self._kept if offset == block.offset), None)
            if data is None:
                data = self._read(file, held, where, block)
                if is_first and len(data) <= _MAX_KEPT:
                    self._kept = (*self._kept[1 - _NUM_KEPT :], (block.offset, data))
            found = list(islice(self._parse(where, block, data, channels), MAX_ENTRIES + 1))
            if len(found) > MAX_ENTRIES:
                raise LimitError(f"{where}: holds more than {MAX_ENTRIES} messages", "LIM001")
            found.sort()
            entries = held.hold(found, len(found), len(data), block.length)
            return self._unpack(entries) if not self._has_packed and self._is_packed(found) else entries
        except RecordError as error:
            self.once("LOG004", (block.offset,), f"byte {block.offset}: {error}")
            return []

    def _read(self, file: BinaryIO, held: Held, where: str, block: Block) -> memoryview:
        records.check_size(where, max(block.length, block.size or 0))
        file.seek(block.offset)
        content = memoryview(file.read(block.length))
        if len(content) != block.length:  # the file has become shorter
            raise RecordError(f"{len(content)} bytes instead of {block.length}")
        if not block.is_chunk:
            return content
        if HEAD.unpack_from(content) != (Opcode.CHUNK, block.length - HEAD.size):
            raise RecordError("no chunk of the indexed length")
        chunk = records.parse_chunk(content[HEAD.size :])
        # A chunk's header has no checksum; the index has one, so that what it says is what counts.
        expected = (block.start_ns, block.end_ns, block.size, block.stored, block.compression)
        got = (chunk.start_ns, chunk.end_ns, chunk.size, len(chunk.data), chunk.compression)
        if block.size is not None and expected != got:
            raise RecordError("chunk isn't the one of the index")
        records.check_chunk(chunk, where)
        if not chunk.crc and block.size is not None:  # else it was counted when the file was walked
            self.once("LOG006", (block.offset,), f"chunk at byte {block.offset}")
        held.require(where, chunk.size, block.length)
        return records.unpack(chunk, where)

    def _is_packed(self, entries: Sequence[Entry]) -> bool:
        """Tell by its first message in CDR whether rosbag2 compressed those of a block one by one: it does all."""
        first = next((entry for entry in entries if entry.channel in self._cdr), None) if self._cdr else None
        return first is not None and is_packed(cast(memoryview, first.data), "cdr")

    def _unpack(self, entries: Iterator[Entry]) -> Iterator[Entry]:
        for entry in entries:
            if entry.channel not in self._cdr and not self._has_packed:
                yield entry
                continue
            try:
                unpacked = entry._replace(data=unpack_message(cast(memoryview, entry.data)))
            except RecordError as error:
                where = f"'{entry.topic}' at {entry.log_ns}: {error}"
                self.once("LOG004", (entry.part, entry.block, entry.offset), where)
            else:
                yield unpacked

    def _parse(self, where: str, block: Block, data: memoryview, channels: frozenset[int]) -> Iterator[Entry]:
        for opcode, start, stop in records.split(data, where):
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


def _read_log_times(file: int, index: Index) -> dict[int, Int64]:
    """Raises RecordError or LimitError where the message indexes can't be trusted."""
    streams = _read_message_indexes(file, index.blocks)
    nums = {channel: sum(len(entries) for _, entries in stream) for channel, stream in streams.items()}
    if nums != {channel: num for channel, num in index.counts.items() if num}:
        raise RecordError("message indexes of more or fewer messages")
    bounds = np.array([(b.start_ns, b.end_ns, b.size or 0) for b in index.blocks], np.uint64).reshape(-1, 3)
    times: dict[int, Int64] = {}
    for channel, stream in sorted(streams.items()):
        entries = np.concatenate([entries for _, entries in stream])
        log_ns = entries["log_ns"]
        start, end, size = bounds[np.repeat([n for n, _ in stream], [len(entries) for _, entries in stream])].T
        if not np.all((start <= log_ns) & (log_ns <= end) & (entries["offset"] + HEAD.size <= size)):
            raise RecordError("message indexes contradict their chunks")
        if len(log_ns) and int(log_ns.max()) > np.iinfo(np.int64).max:
            raise RecordError("a log time is too large")
        times[channel] = np.sort(log_ns.astype(np.int64), kind="stable")
    return times


def _read_message_indexes(file: int, blocks: Sequence[Block]) -> dict[int, list[tuple[int, Array]]]:
    """Entries of each channel, and the numbers of their chunks."""
    streams: dict[int, list[tuple[int, Array]]] = {}
    for number, block in enumerate(blocks):
        # Not through a buffer, which would read more than what is wanted.
        data = memoryview(os.pread(file, block.index_length, block.offset + block.length))
        if len(data) != block.index_length:
            raise RecordError("a message index is cut off")
        found = []
        for opcode, start, stop in records.split(data, "message indexes"):
            if opcode != Opcode.MESSAGE_INDEX or stop - start < _ARRAY.size:
                raise RecordError("no message index")
            channel, length = _ARRAY.unpack_from(data, start)
            if length != stop - start - _ARRAY.size or length % _ENTRY.itemsize:
                raise RecordError("a message index is of another length")
            streams.setdefault(channel, []).append((number, np.frombuffer(data[start + _ARRAY.size : stop], _ENTRY)))
            found.append(channel)
        if sorted(found) != sorted(block.channels or ()):
            raise RecordError("message indexes of other channels")
    return streams


def _escape(text: str) -> str:
    """Show the bytes of a text that aren't UTF-8 as `\\xff`."""
    if text.isascii():  # not copied, as there can be millions
        return text
    return text.encode(errors="surrogateescape").decode(errors="backslashreplace")
