"""Index of an MCAP file: what it holds and where, from its summary, checked by its checksum."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Metadata, MetadataIndex, Schema, Statistics

from fbench.replay.contracts.errors import LimitError
from fbench.replay.logs import container as header
from fbench.replay.logs.containers.limits import crc32
from fbench.replay.logs.containers.mcap.records import (
    HEAD,
    MAGIC,
    MAX_RECORD,
    RecordError,
    parse_record,
    read_head,
    records,
)

_TIMES = struct.Struct("<QQQQI")
_OFFSET = struct.Struct("<HQ")
_LENGTHS = struct.Struct("<QI")
_SIZES = struct.Struct("<QQ")
_MAX_OFFSETS = 2**16 * _OFFSET.size  # One for each channel


class ChunkIndex(NamedTuple):
    """Where a chunk is and what it holds."""

    start_ns: int
    end_ns: int
    offset: int  # Of the chunk record in the file, with its length [byte]
    length: int
    channels: frozenset[int]  # Those that have a message index behind the chunk
    index_length: int  # Of all its message indexes [byte]
    compression: str
    stored: int  # Size of the content, compressed and not [byte]
    size: int


def parse_chunk_index(content: memoryview) -> ChunkIndex:
    """Parse the content of a chunk index record. Raises RecordError where its lengths don't fit together."""
    try:
        start_ns, end_ns, offset, length, num_bytes = _TIMES.unpack_from(content)
        if num_bytes > _MAX_OFFSETS:
            raise RecordError(f"chunk index has {num_bytes} bytes of offsets")
        at = _TIMES.size + num_bytes
        channels = frozenset(id_ for id_, _ in _OFFSET.iter_unpack(content[_TIMES.size : at]))
        index_length, num_text = _LENGTHS.unpack_from(content, at)
        at += _LENGTHS.size + num_text
        compression = str(content[at - num_text : at], "utf-8")
        stored, size = _SIZES.unpack_from(content, at)
    except (struct.error, UnicodeDecodeError) as error:
        raise RecordError(f"chunk index can't be read ({error})") from error
    if at + _SIZES.size != len(content):
        raise RecordError(f"chunk index of {len(content)} bytes ends after {at + _SIZES.size}")
    return ChunkIndex(start_ns, end_ns, offset, length, channels, index_length, compression, stored, size)


MAX_DEFINITIONS = 16 * 1024 * 1024
"""Schemas and channels of a file that take more together are refused: parsed, channels take many times as much."""
MAX_METADATA = 4 * 1024 * 1024
MAX_CHUNKS = 2**19
"""Each takes hundreds of bytes in the index of a file; with chunks of the usual size that is half a terabyte."""
_OWN = len(header.NAME).to_bytes(4, "little") + header.NAME.encode()


def check_definitions(where: str, size: int) -> None:
    """Refuse schemas and channels that are larger than `MAX_DEFINITIONS`. Raises LimitError naming the place."""
    if size > MAX_DEFINITIONS:
        raise LimitError(f"{where}: schemas and channels of more than {MAX_DEFINITIONS} bytes", "LIM001")


def check_chunks(where: str, num: int) -> None:
    """Refuse more than `MAX_CHUNKS` chunks. Raises LimitError naming the file."""
    if num > MAX_CHUNKS:
        raise LimitError(f"{where}: more than {MAX_CHUNKS} chunks; write larger ones", "LIM001")


def own_metadata(content: bytes) -> Metadata | None:
    """Parse a metadata record of fbench; those of others aren't used. Raises RecordError where it is damaged or too
    large.
    """
    if not content.startswith(_OWN):
        return None
    if len(content) > MAX_METADATA:
        raise RecordError(f"metadata of {len(content)} bytes, more than the limit of {MAX_METADATA}")
    record: Metadata = parse_record(Metadata.read, content)
    return record


_FOOTER = HEAD.size + 20
_MAX_SETS = 2**21  # Of the channels of all chunks together; beyond, it isn't kept which ones a chunk has
_DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.METADATA_INDEX)


@dataclass(frozen=True, slots=True)
class Block:
    """A part of a file that is read at once: a chunk, or a run of messages outside chunks."""

    offset: int  # Of its first record in the file [byte]
    length: int
    start_ns: int  # Smallest and largest log time of its messages
    end_ns: int
    channels: frozenset[int] | None  # Ids of the channels that it has messages of; `None`: not known
    is_chunk: bool = True
    size: int | None = None
    """Unpacked and stored size and compression of a chunk as the index says, to be compared; `None`: not known."""
    stored: int = 0
    compression: str = ""
    index_length: int = 0  # Of the message indexes behind a chunk [byte]; 0: there are none, or they aren't known


@dataclass(frozen=True)
class Index:
    """All blocks of a file, with the channels and schemas of their messages."""

    blocks: Sequence[Block]
    channels: Mapping[int, Channel]
    schemas: Mapping[int, Schema]
    metadata: Mapping[str, Metadata] = field(default_factory=dict)
    """fbench's own metadata record by its name; those of others aren't used."""
    counts: Mapping[int, int] = field(default_factory=dict)  # Messages of each channel
    damage: Sequence[str] = ()  # What was found wrong outside the blocks
    is_stored: bool = False  # Whether the file has it; else the file was read to make it

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Log times of the first and the last message; `None` without any."""
        first = min((block.start_ns for block in self.blocks), default=None)
        return None if first is None else (first, max(block.end_ns for block in self.blocks))


class NoIndexError(Exception):
    """The file has no index that can be trusted, with the reason; it must be walked."""


class _Sets:
    """Keeps equal sets of channels once."""

    def __init__(self) -> None:
        self._known: dict[frozenset[int], frozenset[int]] = {}
        self._room = _MAX_SETS

    def shared(self, channels: frozenset[int]) -> frozenset[int]:
        """Return an equal set; the empty one, for channels that aren't known, where there are too many."""
        known = self._known.get(channels)
        if known is None and len(channels) <= self._room:
            self._room -= len(channels)
            known = self._known[channels] = channels
        return frozenset() if known is None else known


@dataclass
class _Summary:
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    statistics: Statistics | None = None
    metadata: set[str] = field(default_factory=set)  # Names of the metadata records that the file should have
    used: set[int] = field(default_factory=set)  # Channels that chunks have messages of


def has_end(file: BinaryIO, size: int) -> bool:
    """Tell whether the file ends as an MCAP file must."""
    file.seek(max(0, size - len(MAGIC)))
    return size >= 2 * len(MAGIC) + _FOOTER and file.read(len(MAGIC)) == MAGIC


def read_index(file: BinaryIO, size: int, name: str) -> Index:
    """Read the index of a file whose end is there. Raises NoIndexError where it is absent, damaged or incomplete.
    Raises LimitError where it would take too much memory; names the file, `name`.
    """
    try:
        start, summary = _summary(file, size, name)
    except RecordError as error:
        raise NoIndexError(f"summary is damaged: {error}") from error
    _check_complete(summary)
    blocks = sorted((_block(chunk) for chunk in summary.chunks), key=lambda block: block.offset)
    covered = sorted((c.offset, c.length + c.index_length) for c in summary.chunks)
    metadata, damage = _between(file, [*covered, (start, 0)])
    if header.NAME in summary.metadata and header.NAME not in metadata:
        damage.append(f"metadata record '{header.NAME}' isn't where the summary says")
    counts = {} if summary.statistics is None else summary.statistics.channel_message_counts
    return Index(blocks, summary.channels, summary.schemas, metadata, counts, damage, is_stored=True)


def _summary(file: BinaryIO, size: int, name: str) -> tuple[int, _Summary]:
    footer_at = size - len(MAGIC) - _FOOTER
    file.seek(footer_at)
    content = file.read(_FOOTER)
    if HEAD.unpack_from(content) != (Opcode.FOOTER, 20):
        raise NoIndexError("no footer")
    footer = parse_record(Footer.read, content[HEAD.size :])
    if footer.summary_start == 0:
        raise NoIndexError("no summary")
    length = footer_at - footer.summary_start
    if not 0 <= length <= MAX_RECORD:
        raise NoIndexError("footer is damaged")
    file.seek(footer.summary_start)
    data = file.read(length)
    if footer.summary_crc == 0:
        raise NoIndexError("summary without checksum")
    if crc32(content[:-4], crc32(data)) != footer.summary_crc:
        raise NoIndexError("checksum of the summary doesn't match")
    return footer.summary_start, _parse_summary(data, f"{name}: summary")


def _parse_summary(data: bytes, where: str) -> _Summary:
    summary = _Summary()
    sets = _Sets()
    num_bytes = 0
    for opcode, start, stop in records(memoryview(data), where):
        if opcode in _DEFINITIONS:
            num_bytes += stop - start
            check_definitions(where, num_bytes)
        content = b"" if opcode == Opcode.CHUNK_INDEX else data[start:stop]
        if opcode == Opcode.SCHEMA:
            schema = parse_record(Schema.read, content)
            summary.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(Channel.read, content)
            summary.channels[channel.id] = channel
        elif opcode == Opcode.CHUNK_INDEX:
            chunk = parse_chunk_index(memoryview(data)[start:stop])
            summary.used |= chunk.channels
            summary.chunks.append(chunk._replace(channels=sets.shared(chunk.channels)))
            check_chunks(where, len(summary.chunks))
        elif opcode == Opcode.STATISTICS:
            summary.statistics = parse_record(Statistics.read, content)
        elif opcode == Opcode.METADATA_INDEX:
            summary.metadata.add(parse_record(MetadataIndex.read, content).name)
    return summary


def _check_complete(summary: _Summary) -> None:
    """Refuse a summary that may know less than the file holds."""
    statistics = summary.statistics
    if statistics is None and not summary.chunks:
        raise NoIndexError("no chunk index")
    if statistics is not None and statistics.chunk_count != len(summary.chunks):
        raise NoIndexError("no chunk index" if not summary.chunks else "chunk index is incomplete")
    if statistics is not None and statistics.message_count and not summary.chunks:
        raise NoIndexError("no chunk index")
    used = summary.used | (set() if statistics is None else set(statistics.channel_message_counts))
    if not used <= set(summary.channels):
        raise NoIndexError("summary lacks channels")
    if any(chunk.length < HEAD.size for chunk in summary.chunks):
        raise NoIndexError("index is inconsistent")
    if any(c.schema_id and c.schema_id not in summary.schemas for c in summary.channels.values()):
        raise NoIndexError("summary lacks schemas")


def _block(chunk: ChunkIndex) -> Block:
    return Block(
        chunk.offset, chunk.length, chunk.start_ns, chunk.end_ns, chunk.channels or None, True, chunk.size,
        chunk.stored, chunk.compression, chunk.index_length,
    )  # fmt: skip


_HARMLESS = (
    Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.ATTACHMENT, Opcode.MESSAGE_INDEX,
    Opcode.DATA_END,
)  # fmt: skip


def _between(file: BinaryIO, covered: Sequence[tuple[int, int]]) -> tuple[dict[str, Metadata], list[str]]:
    """Look at the records that lie between `covered` parts (offset, length); messages there would be missed. Raises
    NoIndexError where there are any.
    """
    metadata: dict[str, Metadata] = {}
    damage: list[str] = []
    at = len(MAGIC)
    for start, num_bytes in covered:
        while at < start:
            head = read_head(file, at)
            if head is None or at + HEAD.size + head[1] > start:
                damage.append(f"record at byte {at} is damaged")
                at = start
                break
            opcode, length = head
            if opcode in (Opcode.MESSAGE, Opcode.CHUNK):
                raise NoIndexError("index is incomplete")
            if opcode not in _HARMLESS:
                damage.append(f"record at byte {at} has unknown type {opcode}")
            elif opcode == Opcode.METADATA:
                _add_metadata(metadata, damage, at, file.read(min(length, MAX_METADATA + 1)))
            at += HEAD.size + length
        if at > start:
            raise NoIndexError("index is inconsistent")
        at = start + num_bytes
    return metadata, damage


def _add_metadata(metadata: dict[str, Metadata], damage: list[str], at: int, content: bytes) -> None:
    try:
        record = own_metadata(content)
        if record is not None:
            metadata.setdefault(record.name, record)
    except RecordError as error:
        damage.append(f"metadata at byte {at}: {error}")
