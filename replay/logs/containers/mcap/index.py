"""Index of an MCAP file: what it holds and where, from its summary, checked by its checksum."""

import struct
from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Metadata, MetadataIndex, Schema, Statistics

from fbench.replay.contracts.errors import LimitError
from fbench.replay.logs import container as header
from fbench.replay.logs.containers.limits import crc32
from fbench.replay.logs.containers.mcap import records
from fbench.replay.logs.containers.mcap.records import HEAD, MAGIC, RecordError, parse_record

_TIMES = struct.Struct("<QQQQI")
_OFFSET = struct.Struct("<HQ")
_LENGTHS = struct.Struct("<QI")
_SIZES = struct.Struct("<QQ")
_MAX_OFFSETS = 2**16 * _OFFSET.size  # One for each channel
_MAX_SETS = 2**21  # Of the channels of all chunks together; beyond, it isn't kept which ones a chunk has
_FOOTER = HEAD.size + 20
MAX_DEFINITIONS = 16 * 1024 * 1024
"""Schemas and channels of a file that take more together are refused: parsed, channels take many times as much."""
MAX_METADATA = 4 * 1024 * 1024
MAX_CHUNKS = 2**19
"""Each takes hundreds of bytes in the index of a file; with chunks of the usual size that is half a terabyte."""
_OWN = len(header.NAME).to_bytes(4, "little") + header.NAME.encode()
_DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.METADATA_INDEX)
_HARMLESS = (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.ATTACHMENT, Opcode.MESSAGE_INDEX, Opcode.DATA_END)


class Block(NamedTuple):
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
    """All blocks of a file, with the channels and schemas of their messages; whoever makes it fills it."""

    blocks: list[Block] = field(default_factory=list)
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    metadata: dict[str, Metadata] = field(default_factory=dict)
    """fbench's own metadata record by its name; those of others aren't used."""
    counts: dict[int, int] = field(default_factory=dict)  # Messages of each channel
    damage: list[str] = field(default_factory=list)  # What was found wrong outside the blocks
    is_stored: bool = False  # Whether the file has it; else the file was read to make it

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Log times of the first and the last message; `None` without any."""
        first = min((block.start_ns for block in self.blocks), default=None)
        return None if first is None else (first, max(block.end_ns for block in self.blocks))

    def add_block(self, block: Block, where: str) -> None:
        """Add a block. Raises LimitError naming the place where there are more than `MAX_CHUNKS`."""
        self.blocks.append(block)
        if len(self.blocks) > MAX_CHUNKS:
            raise LimitError(f"{where}: more than {MAX_CHUNKS} chunks; write larger ones", "LIM001")


class NoIndexError(Exception):
    """The file has no index that can be trusted, with the reason; it must be walked."""


def parse_chunk_index(content: memoryview) -> Block:
    """Parse the content of a chunk index record; its channels are those that have a message index behind the chunk.
    Raises RecordError where its lengths don't fit together.
    """
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
    return Block(offset, length, start_ns, end_ns, channels, True, size, stored, compression, index_length)


def check_definitions(where: str, size: int) -> None:
    """Refuse schemas and channels that are larger than `MAX_DEFINITIONS`. Raises LimitError naming the place."""
    if size > MAX_DEFINITIONS:
        raise LimitError(f"{where}: schemas and channels of more than {MAX_DEFINITIONS} bytes", "LIM001")


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


def has_end(file: BinaryIO, size: int) -> bool:
    """Tell whether the file ends as an MCAP file must."""
    file.seek(max(0, size - len(MAGIC)))
    return size >= 2 * len(MAGIC) + _FOOTER and file.read(len(MAGIC)) == MAGIC


def read_index(file: BinaryIO, size: int, name: str) -> Index:
    """Read the index of a file whose end is there. Raises NoIndexError where it is absent, damaged or incomplete.
    Raises LimitError where it would take too much memory; names the file, `name`.
    """
    index = Index(is_stored=True)
    try:
        start, data = _read_summary(file, size)
        expects_header = _parse_summary(data, f"{name}: summary", index)
    except RecordError as error:
        raise NoIndexError(f"summary is damaged: {error}") from error
    _read_between(file, index, start)
    if expects_header and header.NAME not in index.metadata:
        index.damage.append(f"metadata record '{header.NAME}' isn't where the summary says")
    return index


def _read_summary(file: BinaryIO, size: int) -> tuple[int, bytes]:
    footer_at = size - len(MAGIC) - _FOOTER
    file.seek(footer_at)
    content = file.read(_FOOTER)
    if HEAD.unpack_from(content) != (Opcode.FOOTER, 20):
        raise NoIndexError("no footer")
    footer = parse_record(Footer.read, content[HEAD.size :])
    if footer.summary_start == 0:
        raise NoIndexError("no summary")
    length = footer_at - footer.summary_start
    if not 0 <= length <= records.MAX_RECORD:
        raise NoIndexError("footer is damaged")
    file.seek(footer.summary_start)
    data = file.read(length)
    if footer.summary_crc == 0:
        raise NoIndexError("summary without checksum")
    if crc32(content[:-4], crc32(data)) != footer.summary_crc:
        raise NoIndexError("checksum of the summary doesn't match")
    return footer.summary_start, data


def _parse_summary(data: bytes, where: str, index: Index) -> bool:
    """Fill the index, blocks in the order of the file; returns whether the file should have fbench's metadata record.
    Raises NoIndexError where the summary may know less than the file holds.
    """
    statistics: Statistics | None = None
    names: set[str] = set()  # Of the metadata records that the file should have
    used: set[int] = set()  # Channels that chunks have messages of
    sets: dict[frozenset[int], frozenset[int]] = {}  # Equal ones are kept once
    num_bytes, room = 0, _MAX_SETS
    for opcode, start, stop in records.split(memoryview(data), where):
        if opcode in _DEFINITIONS:
            num_bytes += stop - start
            check_definitions(where, num_bytes)
        if opcode == Opcode.CHUNK_INDEX:
            block = parse_chunk_index(memoryview(data)[start:stop])
            channels = block.channels or frozenset()
            used |= channels
            if channels not in sets and len(channels) <= room:
                room -= len(channels)
                sets[channels] = channels
            index.add_block(block._replace(channels=sets.get(channels) or None), where)
        elif opcode == Opcode.SCHEMA:
            schema = parse_record(Schema.read, data[start:stop])
            index.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(Channel.read, data[start:stop])
            index.channels[channel.id] = channel
        elif opcode == Opcode.STATISTICS:
            statistics = parse_record(Statistics.read, data[start:stop])
        elif opcode == Opcode.METADATA_INDEX:
            names.add(parse_record(MetadataIndex.read, data[start:stop]).name)
    _check_complete(index, statistics, used)
    index.blocks.sort(key=lambda block: block.offset)
    return header.NAME in names


def _check_complete(index: Index, statistics: Statistics | None, used: set[int]) -> None:
    num_chunks = len(index.blocks) if statistics is None else statistics.chunk_count
    if not index.blocks and (statistics is None or num_chunks or statistics.message_count):
        raise NoIndexError("no chunk index")
    if num_chunks != len(index.blocks):
        raise NoIndexError("chunk index is incomplete")
    if statistics is not None:
        index.counts.update(statistics.channel_message_counts)
    if not used | index.counts.keys() <= index.channels.keys():
        raise NoIndexError("summary lacks channels")
    if any(block.length < HEAD.size for block in index.blocks):
        raise NoIndexError("index is inconsistent")
    if any(c.schema_id and c.schema_id not in index.schemas for c in index.channels.values()):
        raise NoIndexError("summary lacks schemas")


def _read_between(file: BinaryIO, index: Index, stop: int) -> None:
    """Look at the records that lie between the blocks and before the summary, at `stop`; messages there would be
    missed. Raises NoIndexError where there are any.
    """
    at = len(MAGIC)
    covered = sorted((block.offset, block.length + block.index_length) for block in index.blocks)
    for start, num_bytes in [*covered, (stop, 0)]:
        while at < start:
            head = records.read_head(file, at)
            if head is None or at + HEAD.size + head[1] > start:
                index.damage.append(f"record at byte {at} is damaged")
                at = start
                break
            opcode, length = head
            if opcode in (Opcode.MESSAGE, Opcode.CHUNK):
                raise NoIndexError("index is incomplete")
            if opcode == Opcode.METADATA:
                try:
                    if record := own_metadata(file.read(min(length, MAX_METADATA + 1))):
                        index.metadata.setdefault(record.name, record)
                except RecordError as error:
                    index.damage.append(f"metadata at byte {at}: {error}")
            elif opcode not in _HARMLESS:
                index.damage.append(f"record at byte {at} has unknown type {opcode}")
            at += HEAD.size + length
        if at > start:
            raise NoIndexError("index is inconsistent")
        at = start + num_bytes
