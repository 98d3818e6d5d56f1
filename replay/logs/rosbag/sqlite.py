"""One SQLite file (`.db3`) of a rosbag2 recording as a container."""

import sqlite3
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fbench.replay.arrays import Int64
from fbench.replay.data import Rig
from fbench.replay.faults import FaultLog
from fbench.replay.logs.container import Channel, Entry
from fbench.replay.logs.header import LogHeader
from fbench.replay.logs.mcap.records import RecordError, check_size
from fbench.replay.logs.rosbag.sqlite_open import FAILURES, check_tables, connected, damaged
from fbench.replay.logs.rosbag.sqlite_topics import read_channels
from fbench.replay.logs.rosbag.zstd import check_format, unpack_message

KEYS = "SELECT timestamp, id FROM messages ORDER BY timestamp, id"
"""Walks the index of timestamps where there is one; else SQLite sorts these two numbers, on disk if need be."""
_KEYS_FROM = "SELECT timestamp, id FROM messages WHERE timestamp >= ? ORDER BY timestamp, id"
_TABLE = "SELECT timestamp, id, topic_id FROM messages NOT INDEXED ORDER BY id"
_HEAD = "SELECT timestamp, topic_id, CASE typeof(data) WHEN 'blob' THEN length(data) END FROM messages WHERE id = ?"
_DATA = "SELECT data FROM messages WHERE id = ?"


class _Head(NamedTuple):
    """All of a message but its payload."""

    log_ns: int
    row: int
    channel: int
    size: int | None
    """Of the payload [byte]; `None`: it isn't binary."""


class Db3File:
    """Finds and reads the messages of a file; each fault is counted once, however often it is met.

    `compression` is that of the single messages, which only the recording's `metadata.yaml` tells.

    Raises:
        LogError: where the file can't be opened, is damaged or not as rosbag2 writes it.
    """

    def __init__(self, path: Path, faults: FaultLog, compression: str = "") -> None:
        check_format(path, compression)
        self.path = path
        self._faults = faults
        self._is_packed = compression == "zstd"
        self._times: Mapping[int, Int64] | None = None
        with connected(path) as database:
            try:
                check_tables(database, path)
                self._channels = read_channels(database, path, lambda row, why: self.once("LOG008", (row,), why))
            except FAILURES as error:
                raise damaged(path, error) from error
        self._check_journals()
        self._check_names()
        self.once("LOG006", (), "SQLite keeps no checksums of messages")

    @property
    def channels(self) -> Mapping[int, Channel]:
        """All topics by id."""
        return self._channels

    @property
    def counts(self) -> Mapping[int, int]:
        """Messages of each topic; reads the whole table, though not the messages in it."""
        times = self.log_times()
        return {number: len(times[number]) for number in self._channels}

    @property
    def header(self) -> LogHeader | None:
        """Written by rosbag2, not by fbench."""
        return None

    @property
    def rigs(self) -> Sequence[tuple[int, Rig]]:
        """Messages tell the rig."""
        return ()

    def log_times(self) -> Mapping[int, Int64]:
        """`log_ns` of each topic's messages, ascending; reads the whole table, though not the messages in it."""
        if self._times is None:
            self._times = self._read_times()
        return self._times

    def entries(self, channels: frozenset[int]) -> Iterator[Entry]:
        """All messages of these topics in canonical order; damaged ones are skipped and counted."""
        return self._entries(channels)

    def entries_from(self, channels: frozenset[int], start_ns: int) -> Iterator[Entry]:
        """All messages of these topics from a log time on."""
        return self._entries(channels, start_ns)

    def _entries(self, channels: frozenset[int], start_ns: int | None = None) -> Iterator[Entry]:
        query, values = (KEYS, ()) if start_ns is None else (_KEYS_FROM, (start_ns,))
        wanted = {number: self._channels[number].topic for number in channels & self._channels.keys()}
        num = 0
        with connected(self.path) as database, closing(database.cursor()) as cursor:
            for _, ties in groupby(self._rows(database, query, values), key=itemgetter(0)):
                heads = [head for head in self._heads(cursor, ties) if head.channel in wanted]
                heads.sort(key=lambda head: (wanted[head.channel], head.row))
                num += len(heads)
                for log_ns, row, channel, data in self._messages(cursor, heads):
                    yield Entry(log_ns, wanted[channel], 0, 0, row, channel, 0, log_ns, data)
        if start_ns is None:
            self._check_complete(num, wanted)

    def verify(self) -> None:
        """There is nothing to compare: these files have no checksums."""

    def once(self, code: str, key: tuple[str | int, ...], where: str) -> None:
        """Count a fault unless `key`, the place, was counted under the same code before."""
        self._faults.once(code, (str(self.path), *key), f"{self.path.name}: {where}")

    def _check_names(self) -> None:
        for number, channel in self._channels.items():
            if "\\" in channel.topic + channel.schema_name:  # which no name of ROS has
                self.once("LOG010", (number,), f"topic {number}, '{channel.topic}'")

    def _check_journals(self) -> None:
        """Count journals: a recorder that was killed left messages in them, and nothing here may change the file."""
        for suffix in ("-wal", "-journal"):
            journal = self.path.with_name(self.path.name + suffix)
            if journal.is_file() and journal.stat().st_size:
                advice = f"`sqlite3 {self.path.name} VACUUM` on a copy of both merges it"
                self.once("LOG002", (suffix,), f"messages in {journal.name} aren't read; {advice}")

    def _rows(
        self, database: sqlite3.Connection, query: str, values: tuple[int, ...] = ()
    ) -> Iterator[tuple[Any, ...]]:
        """Stamp and id of all messages, and what else the query selects; ends at damage, which is counted."""
        last: tuple[int, ...] | None = None
        try:
            for found in database.execute(query, values):
                log_ns, row = found[:2]
                if not isinstance(log_ns, int) or log_ns < 0:
                    self._lost(row, log_ns, "no such stamp")
                    continue
                at = (row,) if query == _TABLE else (log_ns, row)
                if last is not None and at <= last:  # as in a tree of pages that goes in a circle
                    self._broken(f"row {row} is out of order", log_ns)
                    return
                last = at
                yield found
        except FAILURES as error:
            self._broken(str(error), last[0] if last is not None and query != _TABLE else None)

    def _broken(self, reason: str, last_ns: int | None) -> None:
        stamp = "unknown" if last_ns is None else last_ns
        self.once("LOG002", ("table",), f"database is damaged ({reason}), last good stamp {stamp}")

    def _lost(self, row: int, log_ns: object, reason: object) -> None:
        self.once("LOG004", ("row", row), f"row {row} at {log_ns}: {reason}")

    def _heads(self, cursor: sqlite3.Cursor, keys: Iterable[tuple[Any, ...]]) -> Iterator[_Head]:
        for log_ns, row in keys:
            try:
                head = _read_head(cursor, log_ns, row)
            except (RecordError, *FAILURES) as error:
                self._lost(row, log_ns, error)
            else:
                yield head

    def _messages(self, cursor: sqlite3.Cursor, heads: Iterable[_Head]) -> Iterator[tuple[int, int, int, memoryview]]:
        for head in heads:
            check_size(f"{self.path}: row {head.row}", head.size or 0)
            try:
                data = _read_data(cursor, head)
                data = unpack_message(data) if self._is_packed else data
            except (RecordError, *FAILURES) as error:
                self._lost(head.row, head.log_ns, error)
            else:
                yield head.log_ns, head.row, head.channel, data

    def _check_complete(self, num: int, wanted: Mapping[int, str]) -> None:
        expected = sum(len(self.log_times()[number]) for number in wanted)
        if num != expected:
            self.once("LOG004", ("index",), f"the index of timestamps tells of {num} messages, the table of {expected}")

    def _read_times(self) -> Mapping[int, Int64]:
        times = {number: array("q") for number in self._channels}
        unknown: Counter[int] = Counter()
        with connected(self.path) as database:
            for log_ns, _, channel in self._rows(database, _TABLE):
                if not isinstance(channel, int):
                    continue  # counted where it is met in the order of time
                if channel in times:
                    times[channel].append(log_ns)
                else:
                    unknown[channel] += 1
        for channel, num in sorted(unknown.items()):
            self.once("LOG008", (channel,), f"{num} messages of unknown topic {channel}")
        return {number: np.sort(np.frombuffer(found, np.int64)) for number, found in times.items()}


def _read_head(cursor: sqlite3.Cursor, log_ns: int, row: int) -> _Head:
    found = cursor.execute(_HEAD, (row,)).fetchone()
    if found is None or found[0] != log_ns:
        raise RecordError("the index of timestamps doesn't fit the table")
    _, channel, size = found
    if not isinstance(channel, int):
        raise RecordError("its topic is no number")
    return _Head(log_ns, row, channel, size)


def _read_data(cursor: sqlite3.Cursor, head: _Head) -> memoryview:
    if head.size is None:
        raise RecordError("its data aren't binary")
    return memoryview(cursor.execute(_DATA, (head.row,)).fetchone()[0])
