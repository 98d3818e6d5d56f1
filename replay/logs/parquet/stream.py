"""One stream of a Parquet log: its file, its row groups, and their rows as entries."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Protocol

import numpy as np
import pyarrow as pa

from fbench.replay.arrays import Bool, Int64
from fbench.replay.errors import LogError
from fbench.replay.logs.container import Channel, Entry, Schema
from fbench.replay.logs.foxglove.topics import KIND, SENSOR
from fbench.replay.logs.parquet.footer import read_footer, reason_of
from fbench.replay.logs.parquet.groups import GroupFile
from fbench.replay.logs.parquet.log_json import GroupEntries, StreamEntry
from fbench.replay.logs.parquet.names import default_topic
from fbench.replay.logs.parquet.rows import Row, Rows
from fbench.replay.logs.parquet.source import checked_path
from fbench.replay.logs.parquet.thrift import DamageError

STORED = "fbench"
"""Encoding of the channels whose rows are decoded messages."""
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
    base: int
    """Rows of all streams before it: without a column `position` its rows count from here."""
    channel: Channel
    groups: GroupFile
    first_rows: list[int]
    """Number of the first row of each row group, and of all rows."""
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
                yield from self._sorted(rows, group, first_row, counter)
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

    def _sorted(self, rows: Rows, group: int, first_row: int, counter: Counter) -> Iterator[Entry]:
        log_ns = rows.numbers["log_ns"].values
        numbers = np.arange(first_row, first_row + rows.num) + self.base
        position = rows.numbers.get("position")
        positions = numbers if position is None else np.where(position.valid, position.values, numbers)
        order = np.lexsort((positions, log_ns))
        good = self._usable(rows, group, first_row, counter)
        make = self._raw if self.entry.kind == "raw" else self._typed
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

    def _typed(self, rows: Rows, row: int, log_ns: int, at: tuple[int, int]) -> Entry:
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
    """Open a stream of the log in `folder`; `base` rows are in the streams before it.

    Raises:
        LogError: where its file is missing, damaged, lacks columns or doesn't fit `log.json`.
    """
    path = checked_path(folder, entry.file)
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
