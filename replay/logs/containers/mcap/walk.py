"""Index of an MCAP file without a usable summary: one pass over its records, all checksums verified."""

import struct
from collections import Counter
from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Schema

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.scores import format_count
from fbench.replay.logs.containers.limits import crc32
from fbench.replay.logs.containers.mcap import records
from fbench.replay.logs.containers.mcap.index import Block, Index, check_definitions, own_metadata
from fbench.replay.logs.containers.mcap.records import HEAD, MAGIC, MESSAGE, RecordError, check_size, parse_record

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
        last = max((block.end_ns for block in walker.index.blocks), default="none")
        faults.add("LOG002", f"{name}: truncated at byte {walker.at}, last good stamp {last}")
    walker.check_sums(end)
    walker.index.counts.update(walker.counts)
    return walker.index


@dataclass
class _Run:
    """Consecutive records of which some are messages."""

    offset: int
    stop: int
    is_chunk: bool = False
    start_ns: int = 2**64
    end_ns: int = 0
    channels: set[int] = field(default_factory=set)


class _Walker:
    def __init__(self, file: BinaryIO, name: str, size: int, faults: FaultLog) -> None:
        self.index = Index()
        self.counts: Counter[int] = Counter()
        self._plain: Counter[int] = Counter()  # Those of messages outside chunks
        self.at = len(MAGIC)
        self._file, self._name, self._size, self._faults = file, name, size, faults
        self._crc = crc32(MAGIC)
        self._damaged = False
        self._run: _Run | None = None
        self._num_plain = self._num_unverified = self._num_foreign = self._num_defined = 0
        self._contents: dict[tuple[int, bytes], bytes] = {}

    def run(self) -> int | None:
        """Visit all records; returns the stored checksum of the data section, `None` where the file is cut off."""
        while True:
            head = records.read_head(self._file, self.at)
            if head is None or head[1] > self._size - self.at - HEAD.size:
                self._close_run()
                return None
            opcode, length = head
            if opcode == Opcode.DATA_END:
                self._close_run()
                try:
                    return int(parse_record(DataEnd.read, self._file.read(min(length, _PIECE))).data_section_crc)
                except RecordError as error:
                    self._damage(str(error))
                    return 0
            self._crc = crc32(HEAD.pack(*head), self._crc)
            self._visit(opcode, length)
            self.at += HEAD.size + length

    def check_sums(self, expected: int | None) -> None:
        """Compare the checksum of the data section, the only one that messages outside chunks and metadata have: where
        it doesn't match, any of these messages may be the damaged one, so that none counts.
        """
        if self._num_unverified:
            self._faults.add(
                "LOG006", f"{self._name}: {format_count(self._num_unverified, 'chunk')}", self._num_unverified
            )
        if not expected:
            if self._num_plain:
                self._faults.add("LOG006", f"{self._name}: {format_count(self._num_plain, 'message')} outside chunks")
            return
        if expected == self._crc:
            return
        where = f"{self._name}: byte {len(MAGIC)}: checksum of the data section doesn't match"
        if self._num_plain:
            self.index.blocks[:] = [block for block in self.index.blocks if block.is_chunk]
            self.counts.subtract(self._plain)
            messages = format_count(self._num_plain, "message")
            self._faults.add("LOG004", f"{where}, so that none of {messages} outside chunks can be trusted")
        elif self._num_foreign and not self._damaged:
            self._faults.add("LOG004", f"{where}, it isn't known where")
        elif not self._damaged:
            self._faults.add("LOG005", self._name)

    def _visit(self, opcode: int, length: int) -> None:
        if opcode not in (Opcode.MESSAGE, Opcode.CHANNEL, Opcode.SCHEMA):
            self._close_run()
        if opcode in _QUIET:
            self._skip(opcode, length)
            return
        check_size(f"{self._name}: record at byte {self.at}", length)
        content = self._file.read(length)
        self._crc = crc32(content, self._crc)
        try:
            if opcode == Opcode.MESSAGE:
                self._message(content)
            elif opcode == Opcode.CHUNK:
                self._chunk(records.parse_chunk(memoryview(content)), length)
            elif opcode == Opcode.METADATA:
                record = own_metadata(content)
                if record is None:
                    self._num_foreign += 1
                else:
                    self.index.metadata.setdefault(record.name, record)
            elif opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
                self._define(opcode, content)
            else:
                self._damage(f"record has unknown type {opcode}")
        except RecordError as error:
            self._damage(str(error))

    def _skip(self, opcode: int, length: int) -> None:
        """Pass what isn't needed, but not a chunk whose type was changed into that of a message index by damage."""
        rest = length
        while rest > 0:
            piece = self._file.read(min(rest, _PIECE))
            if opcode == Opcode.MESSAGE_INDEX and rest == length and not _is_index(piece, length):
                self._damage("message index is damaged")
            self._crc = crc32(piece, self._crc)
            rest -= len(piece) or rest

    def _message(self, content: bytes) -> None:
        if len(content) < MESSAGE.size:
            raise RecordError("message is too short")
        stop = self.at + HEAD.size + len(content)
        if self._run is None or stop - self._run.offset > _RUN:
            self._close_run()
            self._run = _Run(self.at, stop)
        self._run.stop = stop
        self._count(self._run, content, 0)
        self._plain[MESSAGE.unpack_from(content)[0]] += 1
        self._num_plain += 1

    def _count(self, run: _Run, data: bytes | memoryview, at: int) -> None:
        channel, _, log_ns, _ = MESSAGE.unpack_from(data, at)
        run.start_ns, run.end_ns = min(run.start_ns, log_ns), max(run.end_ns, log_ns)
        run.channels.add(channel)
        self.counts[channel] += 1

    def _close_run(self) -> None:
        run, self._run = self._run, None
        if run is not None and run.channels:
            channels = frozenset(run.channels)
            block = Block(run.offset, run.stop - run.offset, run.start_ns, run.end_ns, channels, run.is_chunk)
            self.index.add_block(block, self._name)

    def _chunk(self, chunk: records.Chunk, length: int) -> None:
        where = f"{self._name}: chunk at byte {self.at}"
        records.check_chunk(chunk, where)
        data = records.unpack(chunk, where)
        run = _Run(self.at, self.at + HEAD.size + length, is_chunk=True)
        for opcode, start, stop in records.split(data, where):
            if opcode == Opcode.MESSAGE and stop - start >= MESSAGE.size:
                self._count(run, data, start)
            elif opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
                check_definitions(where, stop - start)
                try:
                    self._define(opcode, bytes(data[start:stop]))
                except RecordError as error:  # its messages count as those of an unknown channel
                    self._damage(str(error))
        self._num_unverified += chunk.crc == 0
        self._run = run
        self._close_run()

    def _define(self, opcode: int, content: bytes) -> None:
        """Add a channel or schema that isn't there yet: some writers repeat all of them in each chunk."""
        key = (opcode, content[:2])
        if self._contents.get(key) == content:
            return
        self._num_defined += len(content)
        check_definitions(f"{self._name}: byte {self.at}", self._num_defined)
        self._contents[key] = content
        if opcode == Opcode.SCHEMA:
            schema = parse_record(Schema.read, content)
            self.index.schemas.setdefault(schema.id, schema)
            return
        channel = parse_record(Channel.read, content)
        known = self.index.channels.setdefault(channel.id, channel)
        if known != channel:
            topics = f"'{known.topic}' and '{channel.topic}'"
            raise LogError(f"{self._name}: channel {channel.id} is both {topics}", "LOG009")

    def _damage(self, reason: str) -> None:
        self._damaged = True
        self._faults.add("LOG004", f"{self._name}: byte {self.at}: {reason}")


def _is_index(start: bytes, length: int) -> bool:
    """Tell whether a record that starts so can be a message index of this length."""
    return len(start) >= _INDEX.size and length == _INDEX.size + int(_INDEX.unpack_from(start)[1])
