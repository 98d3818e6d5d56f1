"""A ROS 1 bag (version 2.0) as a container, also without a usable index."""

import os
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Int64
from fbench.replay.data.scores import format_count
from fbench.replay.logs.container import Channel, Entry, merge_blocks
from fbench.replay.logs.containers.limits import Held, StoredLog
from fbench.replay.logs.containers.mcap.records import RecordError, check_size
from fbench.replay.logs.containers.rosbag import bag1_index as index
from fbench.replay.logs.containers.rosbag.bag1_records import Op, Record, connection, read_record

MAX_CHANNELS = 2**16 - 1


def walk(
    file: BinaryIO, name: str, header: index.BagHeader, size: int, chunks: Sequence[int], faults: FaultLog
) -> index.Index:
    """Index a bag from its records; counts what is damaged or cut off.

    After damage it goes on at the next of `chunks`, offsets that a damaged index told, where there is one. Raises
    LogError where a record or chunk is larger than the limit, or a compression is unknown.
    """
    walker = _Walker(file, name, size, chunks, faults)
    walker.run(header.stop)
    if walker.is_cut or (header.index_pos != 0 and walker.num_infos != header.num_chunks):
        last = max((block.end_ns for block in walker.blocks), default="none")
        faults.add("LOG002", f"{name}: truncated at byte {walker.at}, last good stamp {last}")
    return index.Index(walker.blocks, walker.channels, is_complete=False)


class _Walker:
    def __init__(self, file: BinaryIO, name: str, size: int, chunks: Sequence[int], faults: FaultLog) -> None:
        self.blocks: list[index.Block] = []
        self.channels: dict[int, Channel] = {}
        self.num_infos = self.at = 0
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
        stop = record.stop
        try:
            if record.op == Op.CHUNK:
                stop = self._index_end(stop)
                self._chunk(stop - self.at)
            elif record.op == Op.CONNECTION:
                check_size(f"{self._name}: connection at byte {record.start}", stop - record.data)
                self._file.seek(record.data)
                self._define(*connection(record, memoryview(self._file.read(stop - record.data))))
            elif record.op == Op.CHUNK_INFO:
                self.num_infos += 1
            elif record.op != Op.INDEX_DATA:
                self._damage(f"record has unknown type {record.op}")
        except RecordError as error:
            self._damage(str(error))
        self.at = stop

    def _chunk(self, length: int) -> None:
        where = f"{self._name}: chunk at byte {self.at}"
        check_size(where, length)
        self._file.seek(self.at)
        content = index.parse_block(where, memoryview(self._file.read(length)), is_indexed=False, held=Held())
        for number, channel in content.connections:
            self._define(number, channel)
        if content.messages:
            self.blocks.append(content.block(self.at, length, is_indexed=False))

    def _index_end(self, at: int) -> int:
        """End of the index records that follow a chunk."""
        try:
            while (record := read_record(self._file, at, self._size)) is not None and record.op == Op.INDEX_DATA:
                at = record.stop
        except RecordError:
            pass  # met again, and counted, by the walk
        return at

    def _define(self, number: int, channel: Channel) -> None:
        if len(self.channels) == MAX_CHANNELS:
            raise LogError(f"{self._name}: more than {MAX_CHANNELS} connections")
        if self.channels.setdefault(number, channel) != channel:
            self._damage(f"connection {number} is defined twice, as topic '{channel.topic}' here")

    def _damage(self, reason: str) -> None:
        self._faults.add("LOG004", f"{self._name}: byte {self.at}: {reason}")


class Ros1Bag(StoredLog):
    """Finds and reads the messages of a bag; each fault is counted once, however often it is met. Raises LogError where
    the file can't be opened or isn't a bag that fbench reads.
    """

    keeps_checksums = False

    def __init__(self, path: Path, faults: FaultLog) -> None:
        super().__init__(path, faults)
        with self._open() as file:
            self._index = self._read_index(file, os.fstat(file.fileno()).st_size)
        self.channels = self._index.channels
        self.counts: Counter[int] = Counter(dict.fromkeys(self.channels, 0))
        unknown = set()
        for block in self._index.blocks:
            unknown |= block.counts.keys() - self.channels.keys()
            self.counts.update({number: num for number, num in block.counts.items() if number in self.channels})
        for number in sorted(unknown):
            self.once("LOG008", (number,), f"messages on unknown connection {number}")
        for number, channel in self.channels.items():
            if "\\" in channel.topic + channel.schema_name:  # which no name of ROS has
                self.once("LOG010", (number,), f"connection {number}, topic '{channel.topic}'")
        faults.add(
            "LOG006", f"{path.name}: {format_count(self.counts.total(), 'message')}, ROS 1 bags have no checksums"
        )

    def entries(self, channels: frozenset[int], start_ns: int | None = None) -> Iterator[Entry]:
        """All messages of these connections from a log time on in canonical order, no chunk that ends before is read;
        damaged chunks are skipped and counted.
        """
        blocks = [
            block
            for block in self._index.blocks
            if (start_ns is None or block.end_ns >= start_ns) and not channels.isdisjoint(block.counts)
        ]
        held = Held()
        with self._open() as file:
            entries = merge_blocks(blocks, lambda block: self._load(file, held, block, channels))
            yield from entries if start_ns is None else (entry for entry in entries if entry.log_ns >= start_ns)

    def log_times(self) -> Mapping[int, Int64] | None:
        """`log_ns` of each connection's messages, ascending; `None` where the bag has no index."""
        if not self._index.is_complete:
            return None
        times: dict[int, list[Int64]] = {number: [np.empty(0, np.int64)] for number in self.channels}
        with self._open() as file:
            for block in self._index.blocks:
                try:
                    for number, found in index.index_records(file, block.offset, block.offset + block.length):
                        times[number].append(found)
                except RecordError as error:
                    raise LogError(f"{self.path}: changed while it was read ({error})") from error
        return {number: np.sort(np.concatenate(found)) for number, found in times.items()}

    def _read_index(self, file: BinaryIO, size: int) -> index.Index:
        header = index.read_header(file, str(self.path), size)
        try:
            return index.read_index(file, header, size)
        except index.NoIndexError as reason:
            self._faults.add("LOG003", f"{self.path.name}: {reason}")
            return walk(file, self.path.name, header, size, reason.chunks, self._faults)

    def _load(self, file: BinaryIO, held: Held, block: index.Block, channels: frozenset[int]) -> Iterable[Entry]:
        where = f"{self.path.name}: chunk at byte {block.offset}"
        check_size(where, block.length)
        file.seek(block.offset)
        try:
            content = index.parse_block(where, memoryview(file.read(block.length)), block.is_indexed, held)
            if not content.messages or content.block(block.offset, block.length, block.is_indexed) != block:
                raise RecordError("chunk isn't the one of the index")
        except RecordError as error:
            self.once("LOG004", (block.offset,), f"byte {block.offset}: {error}")
            return []
        for number, channel in content.connections:
            if self.channels.get(number) != channel:
                changed = f"byte {block.offset}: connection {number} isn't that of the index"
                self.once("LOG004", ("connection", number), changed)
        found = self._entries(content, block, channels)
        return held.hold(found, len(content.messages), len(content.data), block.length)

    def _entries(self, content: index.Content, block: index.Block, channels: frozenset[int]) -> Iterator[Entry]:
        """Messages of a block in canonical order, made one by one."""
        topics = {number: self.channels[number].topic for number in channels & self.channels.keys()}
        wanted = [message for message in content.messages if message.connection in topics]
        wanted.sort(key=lambda message: (message.log_ns, topics[message.connection], message.start))
        for log_ns, number, start, data, stop in wanted:
            payload = content.data[data:stop]
            yield Entry(log_ns, topics[number], 0, block.offset, start, number, 0, log_ns, payload)
