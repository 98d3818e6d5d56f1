"""A ROS 1 bag (version 2.0) as a container, also without a usable index."""

import os
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Int64
from fbench.replay.data.rig import Rig
from fbench.replay.logs.container import Channel, Entry, LogHeader, merge_blocks
from fbench.replay.logs.containers.limits import Held
from fbench.replay.logs.containers.mcap.records import RecordError, check_size
from fbench.replay.logs.containers.rosbag.bag1_index import (
    BagHeader,
    Block,
    Content,
    Index,
    NoIndexError,
    index_records,
    parse_block,
    read_header,
    read_index,
)
from fbench.replay.logs.containers.rosbag.bag1_records import Op, Record, connection, read_record

MAX_CHANNELS = 2**16 - 1


def walk(file: BinaryIO, name: str, header: BagHeader, size: int, chunks: Sequence[int], faults: FaultLog) -> Index:
    """Index a bag from its records; counts what is damaged or cut off.

    After damage it goes on at the next of `chunks`, offsets that a damaged index told, where there is one. Raises
    LogError where a record or chunk is larger than the limit, or a compression is unknown.
    """
    walker = _Walker(file, name, size, chunks, faults)
    walker.run(header.stop)
    is_closed = header.index_pos != 0
    if walker.is_cut or (is_closed and walker.num_infos != header.num_chunks):
        last = max((block.end_ns for block in walker.blocks), default="none")
        faults.add("LOG002", f"{name}: truncated at byte {walker.at}, last good stamp {last}")
    return Index(walker.blocks, walker.channels, is_complete=False)


class _Walker:
    def __init__(self, file: BinaryIO, name: str, size: int, chunks: Sequence[int], faults: FaultLog) -> None:
        self.blocks: list[Block] = []
        self.channels: dict[int, Channel] = {}
        self.num_infos = 0
        self.at = 0
        self.is_cut = False
        self._file, self._name, self._size, self._chunks, self._faults = file, name, size, chunks, faults

    def run(self, start: int) -> None:
        """Visit all records from `start` on."""
        self.at = start
        while self.at < self._size and not self.is_cut:
            try:
                record = read_record(self._file, self.at, self._size)
                op = None if record is None else record.op
            except RecordError as error:  # what follows is garbage, too
                self._damage(str(error))
                self._resume()
                continue
            if record is None or op == Op.MESSAGE:  # a message: the chunk before was never closed, its length is 0
                self._resume()
            else:
                self._visit(record)

    def _resume(self) -> None:
        """Go on at the next chunk that is known; the file ends where there is none."""
        following = bisect_right(self._chunks, self.at)
        if following < len(self._chunks) and self._chunks[following] < self._size:
            self._damage(f"records can't be followed, went on at byte {self._chunks[following]}")
            self.at = self._chunks[following]
        else:
            self.is_cut = True

    def _visit(self, record: Record) -> None:
        try:
            if record.op == Op.CHUNK:
                self._chunk(record)
                return
            if record.op == Op.CONNECTION:
                self._connection(record)
            elif record.op == Op.CHUNK_INFO:
                self.num_infos += 1
            elif record.op != Op.INDEX_DATA:
                self._damage(f"record has unknown type {record.op}")
        except RecordError as error:
            self._damage(str(error))
        self.at = record.stop

    def _chunk(self, chunk: Record) -> None:
        where = f"{self._name}: chunk at byte {self.at}"
        stop = self._index_end(chunk.stop)
        check_size(where, stop - self.at)
        try:
            self._file.seek(self.at)
            content = parse_block(where, memoryview(self._file.read(stop - self.at)), is_indexed=False, held=Held())
            for number, channel in content.connections:
                self._define(number, channel)
            if content.messages:
                self.blocks.append(content.block(self.at, stop - self.at, is_indexed=False))
        except RecordError as error:
            self._damage(str(error))
        self.at = stop

    def _index_end(self, at: int) -> int:
        """End of the index records that follow a chunk."""
        try:
            record = read_record(self._file, at, self._size)
            while record is not None and record.op == Op.INDEX_DATA:
                at = record.stop
                record = read_record(self._file, at, self._size)
        except RecordError:
            pass  # met again, and counted, by the walk
        return at

    def _connection(self, record: Record) -> None:
        check_size(f"{self._name}: connection at byte {record.start}", record.stop - record.data)
        self._file.seek(record.data)
        self._define(*connection(record.fields, memoryview(self._file.read(record.stop - record.data))))

    def _define(self, number: int, channel: Channel) -> None:
        if len(self.channels) == MAX_CHANNELS:
            raise LogError(f"{self._name}: more than {MAX_CHANNELS} connections")
        if self.channels.setdefault(number, channel) != channel:
            self._damage(f"connection {number} is defined twice, as topic '{channel.topic}' here")

    def _damage(self, reason: str) -> None:
        self._faults.add("LOG004", f"{self._name}: byte {self.at}: {reason}")


class Ros1Bag:
    """Finds and reads the messages of a bag; each fault is counted once, however often it is met. Raises LogError where
    the file can't be opened or isn't a bag that fbench reads.
    """

    def __init__(self, path: Path, faults: FaultLog) -> None:
        self.path = path
        self._faults = faults
        with self._open() as file:
            self._index = self._read_index(file, os.fstat(file.fileno()).st_size)
        self._check_names()
        faults.add("LOG006", f"{path.name}: {sum(self.counts.values())} messages, ROS 1 bags have no checksums")

    @property
    def channels(self) -> Mapping[int, Channel]:
        """All connections by number."""
        return self._index.channels

    @property
    def counts(self) -> Mapping[int, int]:
        """Messages of each connection."""
        counts = Counter(dict.fromkeys(self.channels, 0))
        for block in self._index.blocks:
            counts.update({number: num for number, num in block.counts.items() if number in self.channels})
        return counts

    @property
    def header(self) -> LogHeader | None:
        """Bags aren't written by fbench."""
        return None

    @property
    def rigs(self) -> Sequence[tuple[int, Rig]]:
        """Messages tell the rig."""
        return ()

    def entries(self, channels: frozenset[int]) -> Iterator[Entry]:
        """All messages of these connections in canonical order; damaged chunks are skipped and counted."""
        return self._merge(self._index.blocks, channels)

    def entries_from(self, channels: frozenset[int], start_ns: int) -> Iterator[Entry]:
        """All messages of these connections from a log time on; no chunk that ends before is read."""
        blocks = [block for block in self._index.blocks if block.end_ns >= start_ns]
        return (entry for entry in self._merge(blocks, channels) if entry.log_ns >= start_ns)

    def _merge(self, blocks: Sequence[Block], channels: frozenset[int]) -> Iterator[Entry]:
        wanted = [block for block in blocks if not channels.isdisjoint(block.counts)]
        with self._open() as file:
            held = Held()
            yield from merge_blocks(wanted, lambda block: self._load(file, held, block, channels))

    def log_times(self) -> Mapping[int, Int64] | None:
        """`log_ns` of each connection's messages, ascending; `None` where the bag has no index."""
        if not self._index.is_complete:
            return None
        times: dict[int, list[Int64]] = {number: [] for number in self.channels}
        with self._open() as file:
            for block in self._index.blocks:
                for number, found in self._times(file, block):
                    times[number].append(found)
        return {number: np.sort(np.concatenate([np.empty(0, np.int64), *found])) for number, found in times.items()}

    def verify(self) -> None:
        """There is nothing to compare: these files have no checksums."""

    def once(self, code: str, key: tuple[str | int, ...], where: str) -> None:
        """Count a fault unless `key`, the place, was counted under the same code before."""
        self._faults.once(code, (str(self.path), *key), f"{self.path.name}: {where}")

    @contextmanager
    def _open(self) -> Iterator[BinaryIO]:
        try:
            with self.path.open("rb") as file:
                yield file
        except OSError as error:
            raise LogError(f"{self.path}: can't be read ({error.strerror})") from error

    def _read_index(self, file: BinaryIO, size: int) -> Index:
        header = read_header(file, str(self.path), size)
        try:
            return read_index(file, header, size)
        except NoIndexError as reason:
            self._faults.add("LOG003", f"{self.path.name}: {reason}")
            return walk(file, self.path.name, header, size, reason.chunks, self._faults)

    def _check_names(self) -> None:
        unknown = {number for block in self._index.blocks for number in block.counts} - self.channels.keys()
        for number in sorted(unknown):
            self.once("LOG008", (number,), f"messages on unknown connection {number}")
        for number, channel in self.channels.items():
            if "\\" in channel.topic + channel.schema_name:  # which no name of ROS has
                self.once("LOG010", (number,), f"connection {number}, topic '{channel.topic}'")

    def _times(self, file: BinaryIO, block: Block) -> list[tuple[int, Int64]]:
        try:
            return list(index_records(file, block.offset, block.offset + block.length))
        except RecordError as error:
            raise LogError(f"{self.path}: changed while it was read ({error})") from error

    def _load(self, file: BinaryIO, held: Held, block: Block, channels: frozenset[int]) -> Iterable[Entry]:
        where = f"{self.path.name}: chunk at byte {block.offset}"
        check_size(where, block.length)
        file.seek(block.offset)
        try:
            content = parse_block(where, memoryview(file.read(block.length)), block.is_indexed, held)
            self._compare(content, block)
        except RecordError as error:
            self.once("LOG004", (block.offset,), f"byte {block.offset}: {error}")
            return []
        found = self._entries(content, block, channels)
        return held.hold(found, len(content.messages), len(content.data), block.length)

    def _compare(self, content: Content, block: Block) -> None:
        if not content.messages or content.block(block.offset, block.length, block.is_indexed) != block:
            raise RecordError("chunk isn't the one of the index")
        for number, channel in content.connections:
            if self.channels.get(number) != channel:
                where = f"byte {block.offset}: connection {number} isn't that of the index"
                self.once("LOG004", ("connection", number), where)

    def _entries(self, content: Content, block: Block, channels: frozenset[int]) -> Iterator[Entry]:
        """Messages of a block in canonical order, made one by one."""
        topics = {number: self.channels[number].topic for number in channels & self.channels.keys()}
        wanted = [message for message in content.messages if message.connection in topics]
        wanted.sort(key=lambda message: (message.log_ns, topics[message.connection], message.start))
        for log_ns, number, start, data, stop in wanted:
            payload = content.data[data:stop]
            yield Entry(log_ns, topics[number], 0, block.offset, start, number, 0, log_ns, payload)
