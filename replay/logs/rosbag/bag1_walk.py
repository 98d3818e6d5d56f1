"""Indexing a ROS 1 bag without a usable index: one pass over its records."""

from bisect import bisect_right
from collections.abc import Sequence
from typing import BinaryIO

from fbench.replay.errors import LogError
from fbench.replay.faults import FaultLog
from fbench.replay.logs.container import Channel
from fbench.replay.logs.held import Held
from fbench.replay.logs.mcap.records import RecordError, check_size
from fbench.replay.logs.rosbag.bag1_block import Block, parse_block
from fbench.replay.logs.rosbag.bag1_index import BagHeader, Index
from fbench.replay.logs.rosbag.bag1_records import Op, Record, connection, read_record

MAX_CHANNELS = 2**16 - 1


def walk(
    file: BinaryIO, name: str, header: BagHeader, size: int, chunks: Sequence[int], faults: FaultLog
) -> Index:  # fmt: skip
    """Index a bag from its records; counts what is damaged or cut off.

    After damage it goes on at the next of `chunks`, offsets that a damaged index told, where there is one.

    Raises:
        LogError: where a record or chunk is larger than the limit, or a compression is unknown.
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
