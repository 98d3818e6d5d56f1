"""A ROS 1 bag (version 2.0) as a container."""

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from fbench.replay.arrays import Int64
from fbench.replay.data import Rig
from fbench.replay.errors import LogError
from fbench.replay.faults import FaultLog
from fbench.replay.logs.container import Channel, Entry
from fbench.replay.logs.header import LogHeader
from fbench.replay.logs.held import Held
from fbench.replay.logs.mcap.records import RecordError, check_size
from fbench.replay.logs.order import merged
from fbench.replay.logs.rosbag.bag1_block import Block, Content, parse_block
from fbench.replay.logs.rosbag.bag1_index import Index, NoIndexError, index_records, read_header, read_index
from fbench.replay.logs.rosbag.bag1_walk import walk


class Ros1Bag:
    """Finds and reads the messages of a bag; each fault is counted once, however often it is met.

    Raises:
        LogError: where the file can't be opened or isn't a bag that fbench reads.
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
        return self._merged(self._index.blocks, channels)

    def entries_from(self, channels: frozenset[int], start_ns: int) -> Iterator[Entry]:
        """All messages of these connections from a log time on; no chunk that ends before is read."""
        blocks = [block for block in self._index.blocks if block.end_ns >= start_ns]
        return (entry for entry in self._merged(blocks, channels) if entry.log_ns >= start_ns)

    def _merged(self, blocks: Sequence[Block], channels: frozenset[int]) -> Iterator[Entry]:
        wanted = [block for block in blocks if not channels.isdisjoint(block.counts)]
        with self._open() as file:
            held = Held()
            yield from merged(wanted, lambda block: self._load(file, held, block, channels))

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
