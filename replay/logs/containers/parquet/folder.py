"""One Parquet log as a stream of entries in canonical order."""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b
from itertools import accumulate, pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from fbench.replay.contracts.errors import LimitError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Bool, Int64
from fbench.replay.logs.codecs.foxglove.topics import KIND, SENSOR
from fbench.replay.logs.container import Channel, Entry, LogHeader, Schema, merge_blocks
from fbench.replay.logs.containers.limits import StoredLog
from fbench.replay.logs.containers.parquet import log_json
from fbench.replay.logs.containers.parquet.columns import default_topic
from fbench.replay.logs.containers.parquet.footer import MAX_CHUNKS, DamageError, open_regular, read_footer, reason_of
from fbench.replay.logs.containers.parquet.groups import GroupFile
from fbench.replay.logs.containers.parquet.log_json import LogJson, StreamEntry
from fbench.replay.logs.containers.parquet.rows import Row, Rows

STORED = "fbench"  # Encoding of the channels whose rows are decoded messages
_SCHEMAS = {
    "camera": "fbench.Image", "lidar": "fbench.PointCloud", "radar": "fbench.RadarScan", "pose": "fbench.Pose",
    "truth_3d": "fbench.Boxes3D", "truth_2d": "fbench.Boxes2D",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Stream:
    """A stream that can be read; faults are counted in the log that it belongs to."""

    log: StoredLog
    entry: StreamEntry
    number: int
    base: int  # Rows of all streams before it: without a column `position` its rows count from here
    channel: Channel
    groups: GroupFile
    first_rows: list[int]  # Number of the first row of each row group, and of all rows

    @property
    def num_rows(self) -> int:
        """Messages that its file holds."""
        return self.first_rows[-1]

    @cached_property
    def starts(self) -> dict[int, int]:
        """Smallest `log_ns` of each row group that isn't empty; 0 where none can be read, which is counted then."""
        filled = [i for i, (a, b) in enumerate(pairwise(self.first_rows)) if b > a]
        if self.groups.sums is not None:
            return {group: self.groups.sums.min_log_ns[group] for group in filled}
        return {group: int(times.min()) if len(times := self.log_ns(group)) else 0 for group in filled}

    def log_ns(self, group: int) -> Int64:
        """`log_ns` of the rows of a group, none where it is damaged, which is counted."""
        try:
            if self.first_rows[group + 1] > self.first_rows[group]:
                return self.groups.log_ns(group)
        except DamageError as error:
            self._count_damage(group, error)
        return np.zeros(0, np.int64)

    def last_ns(self, group: int) -> int:
        """Largest `log_ns` of a row group, 0 where none can be read."""
        return int(times.max()) if len(times := self.log_ns(group)) else 0

    def entries(self, group: int) -> Iterator[Entry]:
        """Rows of a group as entries in canonical order; counts what can't be read."""
        first_row = self.first_rows[group]
        try:
            for table in self.groups.tables(group):
                try:
                    rows = Rows(table, self.groups.footer.columns)
                except (ValueError, pa.ArrowException) as error:
                    raise DamageError(reason_of(error)) from error
                yield from self._sort(rows, group, first_row)
                first_row += rows.num
        except DamageError as error:
            self._count_damage(group, error)

    def _count_damage(self, group: int, error: DamageError) -> None:
        self.log.once("PQ002", (self.number, group), f"{self.entry.file}: row group {group}: {error}")

    def _sort(self, rows: Rows, group: int, first_row: int) -> Iterator[Entry]:
        log_ns = rows.numbers["log_ns"].values
        numbers = np.arange(first_row, first_row + rows.num) + self.base
        position = rows.numbers.get("position")
        positions = numbers if position is None else np.where(position.valid, position.values, numbers)
        order = np.lexsort((positions, log_ns))
        good, rows_of_log = self._usable(rows, group, first_row).tolist(), numbers.tolist()
        kind, sensor, topic, number = self.entry.kind, self.entry.sensor, self.channel.topic, self.number
        for i, at, ns in zip(order.tolist(), positions[order].tolist(), log_ns[order].tolist(), strict=True):
            if not good[i]:
                continue
            row = Row(rows, i, kind, sensor)
            # The number of the row keeps entries apart where a log gives one position twice.
            if kind == "raw":
                publish_ns, data = row.number("publish_ns"), row.blob("data") or memoryview(b"")
                publish_ns, sequence = ns if publish_ns is None else publish_ns, row.number("sequence") or 0
                yield Entry(ns, topic, 0, at, rows_of_log[i], number, sequence, publish_ns, data)
            else:
                yield Entry(ns, topic, 0, at, rows_of_log[i], number, 0, int(rows.numbers["stamp_ns"].values[i]), row)

    def _usable(self, rows: Rows, group: int, first_row: int) -> Bool:
        """Tell which rows have stamps; the others are counted."""
        columns = [(name, rows.numbers[name]) for name in ("log_ns", "stamp_ns") if name in rows.numbers]
        good = rows.numbers["log_ns"].values >= self.starts.get(group, 0)
        good = good & np.all([c.valid & (c.values >= 0) for _, c in columns], axis=0)
        for row in np.flatnonzero(~good).tolist():
            stamps = ", ".join(f"{name} {column.get(row)}" for name, column in columns)
            where = f"{self.entry.file}: row {first_row + row}: {stamps}"
            self.log.once("DEC001", (self.number, group, first_row + row), where)
        return np.asarray(good)


def _channel(path: Path, entry: StreamEntry) -> Channel:
    if entry.kind == "raw":
        if entry.channel is None:
            raise LogError(f"{path}: stream of kind 'raw' without channel in log.json", "PQ001")
        return entry.channel.channel(entry.topic)
    metadata = {KIND: "truth"}
    if not entry.kind.startswith("truth"):
        metadata = {KIND: entry.kind, SENSOR: entry.sensor}
        if not entry.sensor:
            raise LogError(f"{path}: stream of kind '{entry.kind}' without sensor in log.json", "PQ001")
    topic = entry.topic or default_topic(entry.kind, entry.sensor)
    return Channel(topic, STORED, Schema(_SCHEMAS[entry.kind], "", b""), metadata)


class _Block(NamedTuple):
    """A row group, as `merge_blocks` wants it."""

    start_ns: int
    offset: int
    stream: Stream
    group: int


class ParquetFolder(StoredLog):
    """Finds and reads the messages of a log; implements `fbench.replay.logs.container.Container`.

    Each fault is counted once, however often it is met; every byte is verified when it is read. Raises LogError where
    `log.json` or a file's footer is missing or damaged, or a file lacks columns.
    """

    def __init__(self, path: Path, faults: FaultLog) -> None:
        super().__init__(path, faults)
        where = path / log_json.NAME
        with open_regular(where) as file:
            size = os.fstat(file.fileno()).st_size
            if size > log_json.MAX_BYTES:
                raise LimitError(f"{where}: {size} bytes, the limit is {log_json.MAX_BYTES}", "LIM004")
            description, has_digest = log_json.parse(str(where), os.pread(file.fileno(), size, 0))
        if not has_digest:
            self.once("LOG006", (log_json.NAME,), f"{log_json.NAME} has no digest")
        self._streams = self._open_streams(description.streams)
        self.channels = {stream.number: stream.channel for stream in self._streams}  # Numbered as in `log.json`
        self.counts = {stream.number: stream.num_rows for stream in self._streams}
        try:
            rigs = [(entry.log_ns, entry.rig(), entry.stamp_ns) for entry in description.rigs]
        except LogError as error:
            raise LogError(f"{where}: {error}", "PQ001") from error
        rigs.sort(key=lambda rig: rig[0])
        self.rigs = [(log_ns, rig) for log_ns, rig, _ in rigs]
        self.rig_stamps = [stamp_ns for _, _, stamp_ns in rigs]
        """Stamps of the messages that told the rigs, where `log.json` has them."""
        kinds = self.rigs[0][1].kinds if self.rigs else {}
        log_id = self._digest(description) if description.log_id is None else description.log_id
        self.header = LogHeader(log_id, description.metadata, kinds or description.sensors)

    def entries(self, channels: frozenset[int], start_ns: int | None = None) -> Iterator[Entry]:
        """All messages of these streams from a log time on in canonical order, of row groups that end before only
        `log_ns` is read; damaged row groups are skipped and counted.
        """
        streams = [self._streams[number] for number in sorted(channels)]
        blocks = [
            _Block(start, stream.base + group, stream, group)
            for stream in streams
            for group, start in stream.starts.items()
        ]
        if start_ns is not None:
            blocks = [block for block in blocks if block.stream.last_ns(block.group) >= start_ns]
        entries = merge_blocks(blocks, lambda block: block.stream.entries(block.group))
        yield from entries if start_ns is None else (entry for entry in entries if entry.log_ns >= start_ns)

    def log_times(self) -> Mapping[int, Int64]:
        """`log_ns` of each stream's messages, ascending, from that column alone."""
        times = {}
        for stream in self._streams:
            parts = [stream.log_ns(group) for group in range(len(stream.first_rows) - 1)]
            times[stream.number] = np.sort(np.concatenate([np.zeros(0, np.int64), *parts]), kind="stable")
        return times

    def _open_streams(self, entries: Sequence[StreamEntry]) -> list[Stream]:
        """Raises LogError where a file is missing, damaged, lacks columns or doesn't fit `log.json`."""
        streams: list[Stream] = []
        num_chunks = base = 0
        for number, entry in enumerate(entries):
            if any(stream.entry.file == entry.file for stream in streams):
                raise LogError(f"{self.path / log_json.NAME}: file '{entry.file}' belongs to two streams", "PQ001")
            if entry.file in ("", ".", "..") or any(c in entry.file for c in "/\\\0"):
                raise LogError(f"{self.path}: stream in file {entry.file!r}: not a plain file name", "SEC002")
            path = self.path / entry.file
            footer = read_footer(path, entry.kind, entry.checksums)
            sums = None if entry.checksums is None else entry.checksums.row_groups
            sizes = [group.num_rows for group in footer.groups]
            if sums is not None and sums.num_rows != sizes:
                raise LogError(f"{path}: its row groups aren't those of log.json", "PQ001")
            groups, first_rows = GroupFile(path, footer, sums), [0, *accumulate(sizes)]
            streams.append(Stream(self, entry, number, base, _channel(path, entry), groups, first_rows))
            if sums is None:
                self.once("LOG006", (entry.file,), f"{entry.file} has no checksums in {log_json.NAME}")
            num_chunks += sum(len(group.chunks) for group in footer.groups)
            if num_chunks > MAX_CHUNKS:
                raise LimitError(f"{self.path}: too many row groups; write larger ones", "LIM004")
            base += first_rows[-1]
        return streams

    def _digest(self, description: LogJson) -> str:
        """Id of a log that has none, from `log.json` and the footers of its files."""
        digest = blake2b(log_json.dump(description), digest_size=16)
        for stream in self._streams:
            footer = stream.groups.footer
            digest.update(repr((footer.size, footer.groups)).encode())
        return digest.hexdigest()
