"""One MCAP file as a stream of entries in canonical order."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Schema

from fbench.replay.errors import LogError
from fbench.replay.faults import FaultLog
from fbench.replay.logs.mcap_index import Block, Index, NoIndexError, has_end, read_index
from fbench.replay.logs.mcap_merge import Entry, merged
from fbench.replay.logs.mcap_records import (
    HEAD,
    MAGIC,
    Chunk,
    RecordError,
    check_size,
    parse_chunk,
    records,
    unpack,
)  # fmt: skip
from fbench.replay.logs.mcap_walk import MESSAGE, check_compression, walk
from fbench.replay.logs.sniff import looks_like


class McapFile:
    """Finds and reads the messages of a file; each fault is counted once, however often it is met.

    Raises:
        LogError: where the file can't be opened or isn't MCAP.
    """

    def __init__(self, path: Path, faults: FaultLog) -> None:
        self.path = path
        self._faults = faults
        self._reported: set[tuple[str | int, ...]] = set()
        with self._open() as file:
            self.index = self._read_index(file, os.fstat(file.fileno()).st_size)
        for damage in self.index.damage:
            faults.add("LOG004", f"{path.name}: {damage}")

    def schema(self, channel: int) -> Schema | None:
        """Schema of a channel; `None` where it has none."""
        return self.index.schemas.get(self.index.channels[channel].schema_id)

    def entries(self, channels: frozenset[int]) -> Iterator[Entry]:
        """All messages of these channels in canonical order; damaged blocks are skipped and counted."""
        wanted = [b for b in self.index.blocks if b.channels is None or not b.channels.isdisjoint(channels)]
        with self._open() as file:
            yield from merged(wanted, lambda block: self._load(file, block, channels))

    def first(self, channels: frozenset[int]) -> Entry | None:
        """The first message of these channels."""
        return next(self.entries(channels), None)

    def once(self, code: str, key: tuple[str | int, ...], where: str) -> None:
        """Count a fault unless `key`, the place, was counted under the same code before."""
        if (code, *key) not in self._reported:
            self._reported.add((code, *key))
            self._faults.add(code, f"{self.path.name}: {where}")

    @contextmanager
    def _open(self) -> Iterator[BinaryIO]:
        try:
            with self.path.open("rb") as file:
                yield file
        except OSError as error:
            raise LogError(f"{self.path}: can't be read ({error.strerror})") from error

    def _read_index(self, file: BinaryIO, size: int) -> Index:
        if file.read(len(MAGIC)) != MAGIC:
            raise LogError(f"{self.path}: not an MCAP file (looks like {looks_like(file)})")
        whole = has_end(file, size)
        if not whole:
            return walk(file, self.path.name, size, whole, self._faults)
        try:
            return read_index(file, size)
        except NoIndexError as reason:
            self._faults.add("LOG003", f"{self.path.name}: {reason}")
            return walk(file, self.path.name, size, whole, self._faults)

    def _load(self, file: BinaryIO, block: Block, channels: frozenset[int]) -> list[Entry]:
        where = f"{self.path.name}: byte {block.offset}"
        check_size(where, max(block.length, block.size or 0))
        file.seek(block.offset)
        content = memoryview(file.read(block.length))
        try:
            data = self._unpacked(where, block, content) if block.is_chunk else content
            return sorted(self._parse(block, data, channels))
        except RecordError as error:
            self.once("LOG004", (block.offset,), f"byte {block.offset}: {error}")
            return []

    def _unpacked(self, where: str, block: Block, content: memoryview) -> memoryview:
        if len(content) != block.length or HEAD.unpack_from(content) != (Opcode.CHUNK, block.length - HEAD.size):
            raise RecordError("no chunk of the indexed length")
        chunk = parse_chunk(content[HEAD.size :])
        _compare(block, chunk)
        check_size(where, chunk.size)
        check_compression(where, chunk.compression)
        if not chunk.crc and block.size is not None:  # else it was counted when the file was walked
            self.once("LOG006", (block.offset,), f"chunk at byte {block.offset}")
        return unpack(chunk)

    def _parse(self, block: Block, data: memoryview, channels: frozenset[int]) -> Iterator[Entry]:
        for opcode, start, stop in records(data):
            if opcode != Opcode.MESSAGE:
                continue
            if stop - start < MESSAGE.size:
                raise RecordError("message is too short")
            channel, sequence, log_ns, publish_ns = MESSAGE.unpack_from(data, start)
            if log_ns < block.start_ns:
                raise RecordError(f"holds a message of {log_ns}, before its start {block.start_ns}")
            if channel in channels:
                topic = self.index.channels[channel].topic
                payload = data[start + MESSAGE.size : stop]
                yield Entry(log_ns, topic, block.offset, start, channel, sequence, publish_ns, payload)
            elif channel not in self.index.channels:
                self.once("LOG008", (channel,), f"messages on unknown channel {channel}")


def _compare(block: Block, chunk: Chunk) -> None:
    """A chunk's header has no checksum; the index has one, so that what it says is what counts."""
    expected = (block.start_ns, block.end_ns, block.size, block.stored, block.compression)
    got = (chunk.start_ns, chunk.end_ns, chunk.size, len(chunk.data), chunk.compression)
    if block.size is not None and expected != got:
        raise RecordError("chunk isn't the one of the index")
