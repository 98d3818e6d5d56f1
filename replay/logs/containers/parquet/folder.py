"""One Parquet log as a stream of entries in canonical order."""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import blake2b
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Protocol

import numpy as np
import pyarrow as pa

from fbench.replay.contracts.errors import LimitError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Bool, Int64
from fbench.replay.data.rig import Rig
from fbench.replay.logs.codecs.foxglove.topics import KIND, SENSOR
from fbench.replay.logs.container import Channel, Entry, LogHeader, Schema, merge_blocks
from fbench.replay.logs.containers.parquet import log_json
from fbench.replay.logs.containers.parquet.columns import default_topic
from fbench.replay.logs.containers.parquet.footer import MAX_CHUNKS, DamageError, read_footer, reason_of
from fbench.replay.logs.containers.parquet.groups import GroupFile
from fbench.replay.logs.containers.parquet.log_json import GroupEntries, StreamEntry
from fbench.replay.logs.containers.parquet.rows import Row, Rows
from fbench.replay.logs.containers.parquet.source import check_path, opened

STORED = "fbench"  # Encoding of the channels whose rows are decoded messages
_SCHEMAS = {
    "camera": "fbench.Image", "lidar": "fbench.PointCloud", "radar": "fbench.RadarScan", "pose": "fbench.Pose",
    "truth_3d": "fbench.Boxes3D", "truth_2d": "fbench.Boxes2D",
}  # fmt: skip


class Counter(Protocol):
    """Counts faults, each place once."""

    def once(self, code: str, key: tuple[str | int, ...], where: str) -> None:
        """Count a fault unless `key`, the place, was counted under the same code before."""
        ...


@dataclass(frozen=True, eq=False)
class Stream:
    """A stream that can be read."""

    entry: StreamEntry
    number: int
    base: int  # Rows of all streams before it: without a column `position` its rows count from here
    channel: Channel
    groups: GroupFile
    first_rows: list[int]  # Number of the first row of each row group, and of all rows
    _starts: dict[int, int] = field(default_factory=dict)

    @property
    def num_groups(self) -> int:
        """Row groups of its file."""
        return len(self.groups.footer.groups)

    @property
    def num_rows(self) -> int:
        """Messages that its file holds."""
        return self.first_rows[-1]

    @cached_property
    def _filled(self) -> frozenset[int]:
        return frozenset(i for i, (a, b) in enumerate(pairwise(self.first_rows)) if b > a)

    @property
    def _sums(self) -> GroupEntries | None:
        return self.groups.sums

    def starts(self, counter: Counter) -> dict[int, int]:
        """Smallest `log_ns` of each row group that isn't empty; 0 where none can be read, which is counted then."""
        if not self._starts:
            for group in sorted(self._filled):
                if self._sums is not None:
                    self._starts[group] = self._sums.min_log_ns[group]
                else:
                    log_ns = self.log_ns(group, counter)
                    self._starts[group] = int(log_ns.min()) if len(log_ns) else 0
        return self._starts

    def log_ns(self, group: int, counter: Counter) -> Int64:
        """`log_ns` of the rows of a group, none where it is damaged, which is counted."""
        try:
            return self.groups.log_ns(group) if group in self._filled else np.zeros(0, np.int64)
        except DamageError as error:
            self._damaged(group, counter, error)
            return np.zeros(0, np.int64)

    def last_ns(self, group: int, counter: Counter) -> int:
        """Largest `log_ns` of a row group, 0 where none can be read."""
        log_ns = self.log_ns(group, counter)
        return int(log_ns.max()) if len(log_ns) else 0

    def entries(self, group: int, counter: Counter) -> Iterator[Entry]:
        """Rows of a group as entries in canonical order; counts what can't be read."""
        first_row = self.first_rows[group]
        try:
            for table in self.groups.tables(group):
                rows = self._rows(table)
                yield from self._sort(rows, group, first_row, counter)
                first_row += rows.num
        except DamageError as error:
            self._damaged(group, counter, error)

    def footer_digest(self) -> bytes:
        """What tells this file from others of the same size."""
        footer = self.groups.footer
        return repr((footer.size, footer.groups)).encode()

    def _damaged(self, group: int, counter: Counter, error: DamageError) -> None:
        counter.once("PQ002", (self.number, group), f"{self.entry.file}: row group {group}: {error}")

    def _rows(self, table: pa.Table) -> Rows:
        try:
            return Rows(table, self.groups.footer.columns)
        except (ValueError, pa.ArrowException) as error:
            raise DamageError(reason_of(error)) from error

    def _sort(self, rows: Rows, group: int, first_row: int, counter: Counter) -> Iterator[Entry]:
        log_ns = rows.numbers["log_ns"].values
        numbers = np.arange(first_row, first_row + rows.num) + self.base
        position = rows.numbers.get("position")
        positions = numbers if position is None else np.where(position.valid, position.values, numbers)
        order = np.lexsort((positions, log_ns))
        good = self._usable(rows, group, first_row, counter)
        make = self._raw if self.entry.kind == "raw" else self._type
        for row, at, ns in zip(order.tolist(), positions[order].tolist(), log_ns[order].tolist(), strict=True):
            if good[row]:
                # The number of the row keeps entries apart where a log gives one position twice.
                yield make(rows, row, ns, (at, int(numbers[row])))

    def _usable(self, rows: Rows, group: int, first_row: int, counter: Counter) -> Bool:
        """Tell which rows have stamps; the others are counted."""
        start_ns = self.starts(counter).get(group, 0)
        columns = [(name, rows.numbers[name]) for name in ("log_ns", "stamp_ns") if name in rows.numbers]
        log_ns = rows.numbers["log_ns"].values
        good = (log_ns >= start_ns) & np.all([c.valid & (c.values >= 0) for _, c in columns], axis=0)
        for row in np.flatnonzero(~good).tolist():
            stamps = ", ".join(f"{name} {column.get(row)}" for name, column in columns)
            where = f"{self.entry.file}: row {first_row + row}: {stamps}"
            counter.once("DEC001", (self.number, group, first_row + row), where)
        return np.asarray(good)

    def _type(self, rows: Rows, row: int, log_ns: int, at: tuple[int, int]) -> Entry:
        stored = Row(rows, row, self.entry.kind, self.entry.sensor)
        stamp_ns = int(rows.numbers["stamp_ns"].values[row])
        return Entry(log_ns, self.channel.topic, 0, *at, self.number, 0, stamp_ns, stored)

    def _raw(self, rows: Rows, row: int, log_ns: int, at: tuple[int, int]) -> Entry:
        publish_ns = rows.optional("publish_ns", row)
        return Entry(
            log_ns, self.channel.topic, 0, *at, self.number, rows.optional("sequence", row) or 0,
            log_ns if publish_ns is None else publish_ns, rows.nullable("data", row) or memoryview(b""),
        )  # fmt: skip


def open_stream(folder: Path, entry: StreamEntry, number: int, base: int) -> Stream:
    """Open a stream of the log in `folder`; `base` rows are in the streams before it. Raises LogError where its file is
    missing, damaged, lacks columns or doesn't fit `log.json`.
    """
    path = check_path(folder, entry.file)
    footer = read_footer(path, entry.kind, entry.checksums)
    sums = None if entry.checksums is None else entry.checksums.row_groups
    sizes = [group.num_rows for group in footer.groups]
    if sums is not None and sums.num_rows != sizes:
        raise LogError(f"{path}: its row groups aren't those of log.json", "PQ001")
    first_rows = [0, *accumulate(sizes)]
    return Stream(entry, number, base, _channel(path, entry), GroupFile(path, footer, sums), first_rows)


def _channel(path: Path, entry: StreamEntry) -> Channel:
    if entry.kind == "raw":
        if entry.channel is None:
            raise LogError(f"{path}: stream of kind 'raw' without channel in log.json", "PQ001")
        return entry.channel.channel(entry.topic)
    topic = entry.topic or default_topic(entry.kind, entry.sensor)
    if entry.kind.startswith("truth"):
        return Channel(topic, STORED, Schema(_SCHEMAS[entry.kind], "", b""), {KIND: "truth"})
    if not entry.sensor:
        raise LogError(f"{path}: stream of kind '{entry.kind}' without sensor in log.json", "PQ001")
    return Channel(topic, STORED, Schema(_SCHEMAS[entry.kind], "", b""), {KIND: entry.kind, SENSOR: entry.sensor})


@dataclass(frozen=True, eq=False)
class _Block:
    """A row group, as `merged` wants it."""

    start_ns: int
    offset: int
    stream: Stream
    group: int


class ParquetFolder:
    """Finds and reads the messages of a log; implements `fbench.replay.logs.container.Container`.

    Each fault is counted once, however often it is met. Raises LogError where `log.json` or a file's footer is missing
    or damaged, or a file lacks columns.
    """

    def __init__(self, path: Path, faults: FaultLog) -> None:
        self._path, self._faults = path, faults
        self._description, has_digest = _read_description(path)
        if not has_digest:
            self.once("LOG006", (log_json.NAME,), f"{log_json.NAME} has no digest")
        self._streams = self._open_streams()
        self._rigs = self._read_rigs()

    @property
    def path(self) -> Path:
        """The folder."""
        return self._path

    @cached_property
    def channels(self) -> Mapping[int, Channel]:
        """All streams, numbered as in `log.json`."""
        return {number: stream.channel for number, stream in enumerate(self._streams)}

    @cached_property
    def counts(self) -> Mapping[int, int]:
        """Rows of each stream."""
        return {number: stream.num_rows for number, stream in enumerate(self._streams)}

    @cached_property
    def header(self) -> LogHeader:
        """Id and metadata; a log that has no id gets one from `log.json` and the footers of its files."""
        first = {name: mount.kind for name, mount in self._rigs[0][1].mounts.items()} if self._rigs else {}
        kinds = first or self._description.sensors
        log_id = self._description.log_id
        return LogHeader(self._digest() if log_id is None else log_id, self._description.metadata, kinds)

    @property
    def rigs(self) -> Sequence[tuple[int, Rig]]:
        """All rigs of `log.json`, in the order of time."""
        return self._rigs

    @property
    def rig_stamps(self) -> Sequence[int | None]:
        """Stamps of the messages that told the rigs, where `log.json` has them."""
        return [entry.stamp_ns for entry in sorted(self._description.rigs, key=lambda entry: entry.log_ns)]

    def entries(self, channels: frozenset[int]) -> Iterator[Entry]:
        """All messages of these streams in canonical order; damaged row groups are skipped and counted."""
        yield from merge_blocks(self._blocks(channels), lambda block: block.stream.entries(block.group, self))

    def entries_from(self, channels: frozenset[int], start_ns: int) -> Iterator[Entry]:
        """All messages of these streams from a log time on; of row groups that end before only that column is read."""
        blocks = [block for block in self._blocks(channels) if block.stream.last_ns(block.group, self) >= start_ns]
        entries = merge_blocks(blocks, lambda block: block.stream.entries(block.group, self))
        return (entry for entry in entries if entry.log_ns >= start_ns)

    def _blocks(self, channels: frozenset[int]) -> list[_Block]:
        blocks = []
        for number in sorted(channels):
            stream = self._streams[number]
            starts = stream.starts(self)
            blocks += [_Block(start, stream.base + group, stream, group) for group, start in starts.items()]
        return blocks

    def log_times(self) -> Mapping[int, Int64]:
        """`log_ns` of each stream's messages, ascending, from that column alone."""
        times = {}
        for number, stream in enumerate(self._streams):
            parts = [stream.log_ns(group, self) for group in range(stream.num_groups)]
            times[number] = np.sort(np.concatenate([np.zeros(0, np.int64), *parts]), kind="stable")
        return times

    def verify(self) -> None:
        """Nothing is left: every byte was verified when it was read."""

    def once(self, code: str, key: tuple[str | int, ...], where: str) -> None:
        """Count a fault unless `key`, the place, was counted under the same code before."""
        self._faults.once(code, (str(self._path), *key), f"{self._path.name}: {where}")

    def _open_streams(self) -> list[Stream]:
        streams: list[Stream] = []
        names: set[str] = set()
        base = 0
        for number, entry in enumerate(self._description.streams):
            if entry.file in names:
                raise LogError(f"{self._path / log_json.NAME}: file '{entry.file}' belongs to two streams", "PQ001")
            names.add(entry.file)
            stream = open_stream(self._path, entry, number, base)
            if entry.checksums is None:
                self.once("LOG006", (entry.file,), f"{entry.file} has no checksums in {log_json.NAME}")
            streams.append(stream)
            if sum(s.groups.footer.num_chunks for s in streams) > MAX_CHUNKS:
                raise LimitError(f"{self._path}: too many row groups; write larger ones", "LIM004")
            base += stream.num_rows
        return streams

    def _read_rigs(self) -> list[tuple[int, Rig]]:
        where = self._path / log_json.NAME
        try:
            rigs = [(entry.log_ns, entry.rig()) for entry in self._description.rigs]
        except LogError as error:
            raise LogError(f"{where}: {error}", "PQ001") from error
        return sorted(rigs, key=lambda rig: rig[0])

    def _digest(self) -> str:
        digest = blake2b(log_json.dump(self._description), digest_size=16)
        for stream in self._streams:
            digest.update(stream.footer_digest())
        return digest.hexdigest()


def _read_description(path: Path) -> tuple[log_json.LogJson, bool]:
    where = path / log_json.NAME
    with opened(where) as file:
        size = os.fstat(file.fileno()).st_size
        if size > log_json.MAX_BYTES:
            raise LimitError(f"{where}: {size} bytes, the limit is {log_json.MAX_BYTES}", "LIM004")
        return log_json.parse(str(where), os.pread(file.fileno(), size, 0))
