"""Index of an MCAP file without a usable summary: one pass over its records, all checksums verified."""

import struct
from collections import Counter
from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Metadata, Schema

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.containers.limits import crc32
from fbench.replay.logs.containers.mcap.index import Block, Index, check_chunks, check_definitions, own_metadata
from fbench.replay.logs.containers.mcap.records import (
    COMPRESSIONS,
    HEAD,
    MAGIC,
    Chunk,
    RecordError,
    check_size,
    parse_chunk,
    parse_record,
    read_head,
    records,
    unpack,
)

MESSAGE = struct.Struct("<HIQQ")  # Channel, sequence, log time and publish time at the start of a message record
_RUN = 1024 * 1024  # Messages outside chunks are read in runs of about this many bytes
_PIECE = 1024 * 1024
_QUIET = (Opcode.HEADER, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT)
_INDEX = struct.Struct("<HI")  # Channel and length of the rest at the start of a message index


def walk(file: BinaryIO, name: str, size: int, whole: bool, faults: FaultLog) -> Index:
    """Index a file from its records; counts what is damaged, cut off (`whole` is false) or unverified. Raises LogError
    where a record or chunk is larger than the limit, a compression is unknown, or one channel id stands for two
    channels.
    """
    walker = _Walker(file, name, size, faults)
    end = walker.run()
    if end is None or not whole:
        last = max((block.end_ns for block in walker.blocks), default="none")
        faults.add("LOG002", f"{name}: truncated at byte {walker.at}, last good stamp {last}")
    walker.check_sums(end)
    return Index(walker.blocks, walker.channels, walker.schemas, walker.metadata, walker.counts)


@dataclass
class _Run:
    """Consecutive records of which some are messages."""

    offset: int
    stop: int
    start_ns: int = 2**64
    end_ns: int = 0
    channels: set[int] = field(default_factory=set)

    def add(self, channel: int, log_ns: int) -> None:
        self.start_ns, self.end_ns = min(self.start_ns, log_ns), max(self.end_ns, log_ns)
        self.channels.add(channel)

    def block(self, is_chunk: bool) -> Block:
        length = self.stop - self.offset
        return Block(self.offset, length, self.start_ns, self.end_ns, frozenset(self.channels), is_chunk)


class _Walker:
    def __init__(self, file: BinaryIO, name: str, size: int, faults: FaultLog) -> None:
        self.blocks: list[Block] = []
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.metadata: dict[str, Metadata] = {}
        self.counts: Counter[int] = Counter()
        self.at = len(MAGIC)
        self._file, self._name, self._size, self._faults = file, name, size, faults
        self._crc = crc32(MAGIC)
        self._damaged = False
        self._run: _Run | None = None
        self._num_plain, self._num_unverified, self._num_foreign = 0, 0, 0
        self._num_defined = 0
        self._contents: dict[tuple[int, bytes], bytes] = {}

    def run(self) -> int | None:
        """Visit all records; returns the stored checksum of the data section, `None` where the file is cut off."""
        while True:
            head = read_head(self._file, self.at)
            if head is None or head[1] > self._size - self.at - HEAD.size:
                self._flush()
                return None
            opcode, length = head
            if opcode == Opcode.DATA_END:
                self._flush()
                return self._data_end(self._file.read(min(length, _PIECE)))
            self._crc = crc32(HEAD.pack(*head), self._crc)
            self._visit(opcode, length)
            self.at += HEAD.size + length

    def check_sums(self, expected: int | None) -> None:
        """Compare the checksum of the data section, the only one that messages outside chunks and metadata have."""
        if self._num_unverified:
            where = f"{self._name}: {self._num_unverified} chunks"
            self._faults.add("LOG006", where, self._num_unverified)
        if not expected:
            if self._num_plain:
                self._faults.add("LOG006", f"{self._name}: {self._num_plain} messages outside chunks")
        elif expected != self._crc and not self._damaged and not self._num_plain + self._num_foreign:
            self._faults.add("LOG005", self._name)
        elif expected != self._crc and not self._damaged:
            self._damage("checksum of the data section doesn't match, it isn't known where", len(MAGIC))

    def _data_end(self, content: bytes) -> int:
        try:
            return int(parse_record(DataEnd.read, content).data_section_crc)
        except RecordError as error:
            self._damage(str(error), self.at)
            return 0

    def _visit(self, opcode: int, length: int) -> None:
        if opcode not in (Opcode.MESSAGE, Opcode.CHANNEL, Opcode.SCHEMA):
            self._flush()
        if opcode in _QUIET:
            self._skip(opcode, length)
            return
        content = self._content(length)
        try:
            if opcode == Opcode.MESSAGE:
                self._message(content)
            elif opcode == Opcode.CHUNK:
                self._chunk(parse_chunk(memoryview(content)), length)
            elif opcode == Opcode.METADATA:
                self._metadata(content)
            elif not self._define(opcode, content):
                self._damage(f"record has unknown type {opcode}", self.at)
        except RecordError as error:
            self._damage(str(error), self.at)

    def _content(self, length: int) -> bytes:
        check_size(f"{self._name}: record at byte {self.at}", length)
        content = self._file.read(length)
        self._crc = crc32(content, self._crc)
        return content

    def _metadata(self, content: bytes) -> None:
        record = own_metadata(content)
        self._num_foreign += record is None
        if record is not None:
            self.metadata.setdefault(record.name, record)

    def _skip(self, opcode: int, length: int) -> None:
        """Pass what isn't needed, but not a chunk whose type was changed into that of a message index by damage."""
        rest = length
        while rest > 0:
            piece = self._file.read(min(rest, _PIECE))
            if opcode == Opcode.MESSAGE_INDEX and rest == length and not _is_index(piece, length):
                self._damage("message index is damaged", self.at)
            self._crc = crc32(piece, self._crc)
            rest -= len(piece) or rest

    def _message(self, content: bytes) -> None:
        if len(content) < MESSAGE.size:
            raise RecordError("message is too short")
        channel, _, log_ns, _ = MESSAGE.unpack_from(content)
        stop = self.at + HEAD.size + len(content)
        if self._run is None or stop - self._run.offset > _RUN:
            self._flush()
            self._run = _Run(self.at, stop)
        self._run.stop = stop
        self._run.add(channel, log_ns)
        self.counts[channel] += 1
        self._num_plain += 1

    def _flush(self) -> None:
        if self._run is not None:
            self._add(self._run.block(is_chunk=False))
        self._run = None

    def _add(self, block: Block) -> None:
        self.blocks.append(block)
        check_chunks(self._name, len(self.blocks))

    def _chunk(self, chunk: Chunk, length: int) -> None:
        where = f"{self._name}: chunk at byte {self.at}"
        check_size(where, chunk.size)
        check_compression(where, chunk.compression)
        data = unpack(chunk, where)
        run = _Run(self.at, self.at + HEAD.size + length)
        for opcode, start, stop in records(data, where):
            if opcode == Opcode.MESSAGE and stop - start >= MESSAGE.size:
                channel, _, log_ns, _ = MESSAGE.unpack_from(data, start)
                run.add(channel, log_ns)
                self.counts[channel] += 1
            elif opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
                check_definitions(where, stop - start)
                self._define_inside(opcode, bytes(data[start:stop]))
        self._num_unverified += chunk.crc == 0
        if run.channels:
            self._add(run.block(is_chunk=True))

    def _define_inside(self, opcode: int, content: bytes) -> None:
        """Add what a chunk defines; where it can't be read, the messages count as those of an unknown channel."""
        try:
            self._define(opcode, content)
        except RecordError as error:
            self._damage(str(error), self.at)

    def _define(self, opcode: int, content: bytes) -> bool:
        """Add a channel or schema; tells whether it is one."""
        if opcode in (Opcode.CHANNEL, Opcode.SCHEMA) and not self._is_new(opcode, content):
            return True
        if opcode == Opcode.CHANNEL:
            channel = parse_record(Channel.read, content)
            if self.channels.setdefault(channel.id, channel) != channel:
                known = self.channels[channel.id].topic
                raise LogError(f"{self._name}: channel {channel.id} is both '{known}' and '{channel.topic}'", "LOG009")
        elif opcode == Opcode.SCHEMA:
            schema = parse_record(Schema.read, content)
            self.schemas.setdefault(schema.id, schema)
        return opcode in (Opcode.CHANNEL, Opcode.SCHEMA)

    def _is_new(self, opcode: int, content: bytes) -> bool:
        """Tell whether a definition isn't there yet: some writers repeat all of them in each chunk."""
        key = (opcode, content[:2])
        if self._contents.get(key) == content:
            return False
        self._num_defined += len(content)
        check_definitions(f"{self._name}: byte {self.at}", self._num_defined)
        self._contents[key] = content
        return True

    def _damage(self, reason: str, at: int) -> None:
        self._damaged = True
        self._faults.add("LOG004", f"{self._name}: byte {at}: {reason}")


def _is_index(start: bytes, length: int) -> bool:
    """Tell whether a record that starts so can be a message index of this length."""
    return len(start) >= _INDEX.size and length == _INDEX.size + int(_INDEX.unpack_from(start)[1])


def check_compression(where: str, compression: str) -> None:
    """Refuse what can't be unpacked. Raises LogError naming the place and the compression."""
    if compression not in COMPRESSIONS:
        raise LogError(f"{where}: unknown compression '{compression}'; fbench reads zstd, lz4 and none", "LOG007")
