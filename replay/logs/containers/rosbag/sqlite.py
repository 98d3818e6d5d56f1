"""One SQLite file (`.db3`) of a rosbag2 recording as a container, opened as untrusted input."""

import os
import sqlite3
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Int64
from fbench.replay.data.rig import Rig
from fbench.replay.logs.container import Channel, Entry, LogHeader, Schema
from fbench.replay.logs.containers.limits import looks_like
from fbench.replay.logs.containers.mcap.records import MAX_RECORD, RecordError, check_size
from fbench.replay.logs.containers.rosbag.zstd import check_format, unpack_message

_MAGIC = b"SQLite format 3\x00"
FAILURES = (sqlite3.Error, UnicodeDecodeError)
"""What `sqlite3` raises for damaged files; it can't decode the messages of some of its own errors."""
_ROW = 1024 * 1024  # Room for what a row holds beside its longest value [byte]
_PRAGMAS = (
    "PRAGMA trusted_schema=OFF", "PRAGMA query_only=ON", "PRAGMA cell_size_check=ON", "PRAGMA cache_size=-16384",
)  # fmt: skip
_TABLES: Mapping[str, tuple[str, ...]] = {
    "topics": ("id", "name", "type", "serialization_format"),
    "messages": ("id", "topic_id", "timestamp", "data"),
}


@contextmanager
def connected(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a database for reading; text comes as bytes. Nothing is written beside the file. Raises LogError where it
    can't be opened, or isn't such a database.
    """
    _check_head(path)
    uri = f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1"
    try:
        # Entries may be read ahead by another thread, though never by two at once.
        database = sqlite3.connect(uri, uri=True, isolation_level=None, check_same_thread=False)
    except FAILURES as error:
        raise damage_error(path, error) from error
    with closing(database):
        database.text_factory = bytes
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_RECORD + _ROW)
        database.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
        try:
            for pragma in _PRAGMAS:
                database.execute(pragma)
        except FAILURES as error:
            raise damage_error(path, error) from error
        yield database


def damage_error(path: Path, error: Exception | str) -> LogError:
    """Return the error for a database that SQLite can't read, or not rightly."""
    return LogError(f"{path}: damaged database ({error}); `sqlite3 {path.name} .recover` may save what is left")


def columns(database: sqlite3.Connection, table: str) -> Mapping[str, bool]:
    """Stored columns of a table, and whether each is the integer key of its rows; empty where there is none."""
    rows = database.execute("SELECT name, type, hidden, pk FROM pragma_table_xinfo(?)", (table,)).fetchall()
    return {
        name.decode("utf-8", "replace").lower(): bool(pk) and kind.upper() == b"INTEGER"
        for name, kind, hidden, pk in rows
        if not hidden
    }


def check_tables(database: sqlite3.Connection, path: Path) -> None:
    """Refuse databases whose tables aren't as rosbag2 makes them: views and computed columns run what others wrote.
    Raises LogError naming the table.
    """
    for table, wanted in _TABLES.items():
        if not is_table(database, table):
            raise LogError(f"{path}: not a recording of rosbag2 (no table '{table}')")
        found = columns(database, table)
        missing = [name for name in wanted if name not in found]
        if missing:
            raise LogError(f"{path}: not a recording of rosbag2 (table '{table}' has no column '{missing[0]}')")
        if not found["id"]:
            raise LogError(f"{path}: not a recording of rosbag2 (table '{table}' isn't keyed by its id)")


def is_table(database: sqlite3.Connection, name: str) -> bool:
    """Tell whether there is a table, not a view or a virtual one, of that name."""
    query = "SELECT count(*) FROM sqlite_master WHERE lower(name) = ? AND type = 'table' AND rootpage > 0"
    return bool(database.execute(query, (name,)).fetchone()[0])


def _check_head(path: Path) -> None:
    """Refuse what isn't a database, or ends early: SQLite refuses files that lack whole pages, but fills up a part of a
    page with zeros. Layout: https://www.sqlite.org/fileformat.html, 1.3.
    """
    try:
        with path.open("rb") as file:
            head = file.read(100)
            if not head.startswith(_MAGIC):
                raise LogError(f"{path}: not an SQLite database (looks like {looks_like(file)})")
            size = file.seek(0, os.SEEK_END)
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error
    page = int.from_bytes(head[16:18], "big")
    page = 65536 if page == 1 else page
    if page and size % page:
        raise damage_error(path, f"it ends within a page of {page} bytes, after {size}")


_MAX_TOPICS = 2**16 - 1
_MAX_TEXT = 4 * 1024 * 1024  # Longer names, definitions and profiles are refused [byte]
_MAX_TEXTS = 256 * 1024 * 1024
_Definitions = Mapping[tuple[bytes, bytes], Schema]
Count = Callable[[int, str], None]


def read_channels(database: sqlite3.Connection, path: Path, skipped: Count) -> Mapping[int, Channel]:
    """Read all topics; `skipped` is told the id of each that is damaged, with the reason. Raises LogError where there
    are more than the limit.
    """
    definitions = _definitions(database, path)
    found = columns(database, "topics")
    optional = [name for name in ("offered_qos_profiles", "type_description_hash") if name in found]
    rows = database.execute(
        f"SELECT {', '.join(['id', *map(_text, ('name', 'type', 'serialization_format', *optional))])}"  # noqa: S608
        f" FROM topics ORDER BY id LIMIT {_MAX_TOPICS + 1}"
    )
    channels: dict[int, Channel] = {}
    budget = _Budget(path)
    for number, *texts in rows:
        if len(channels) == _MAX_TOPICS:
            raise LogError(f"{path}: more than {_MAX_TOPICS} topics")
        budget.take(texts)
        name, kind, encoding, *more = texts
        if name is None or kind is None or encoding is None:
            skipped(number, f"name, type or format of topic {number} is no text of up to {_MAX_TEXT} bytes")
            continue
        metadata = {key: _decode(text) for key, text in zip(optional, more, strict=True) if text}
        digest = metadata.get("type_description_hash", "").encode()
        schema = definitions.get((kind, digest)) or definitions.get((kind, b"")) or Schema(_decode(kind), "", b"")
        channels[number] = Channel(_decode(name), _decode(encoding), schema, metadata)
    return channels


def _definitions(database: sqlite3.Connection, path: Path) -> _Definitions:
    """Definitions by type and hash, the first of each, and by type alone."""
    found = columns(database, "message_definitions") if is_table(database, "message_definitions") else {}
    if not {"topic_type", "encoding", "encoded_message_definition"} <= found.keys():
        return {}
    digest = _text("type_description_hash") if "type_description_hash" in found else "NULL"
    names = ", ".join(map(_text, ("topic_type", "encoding", "encoded_message_definition")))
    definitions: dict[tuple[bytes, bytes], Schema] = {}
    budget = _Budget(path)
    for row in database.execute(f"SELECT {names}, {digest} FROM message_definitions LIMIT {_MAX_TOPICS}"):  # noqa: S608
        budget.take(row)
        kind, encoding, text, hashed = row
        if kind and encoding and text:
            schema = Schema(_decode(kind), _decode(encoding), text)
            definitions.setdefault((kind, hashed or b""), schema)
            definitions.setdefault((kind, b""), schema)
    return definitions


class _Budget:
    """How much text a file may hold in all."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._left = _MAX_TEXTS

    def take(self, texts: tuple[bytes | None, ...] | list[bytes | None]) -> None:
        """Take it; raises `LogError` where it is used up."""
        self._left -= sum(len(text) for text in texts if text is not None)
        if self._left < 0:
            raise LogError(f"{self._path}: topics and definitions have more than the limit of {_MAX_TEXTS} bytes")


def _text(column: str) -> str:
    """Expression for a column that is `NULL` unless it is text of bearable length."""
    # SQLite counts text in characters, and only up to the first NUL.
    size = f"length(CAST({column} AS BLOB))"
    return f"CASE WHEN typeof({column}) = 'text' AND {size} <= {_MAX_TEXT} THEN {column} END"


def _decode(text: bytes) -> str:
    return text.decode("utf-8", "backslashreplace")


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
    size: int | None  # Of the payload [byte]; `None`: it isn't binary


class Db3File:
    """Finds and reads the messages of a file; each fault is counted once, however often it is met.

    `compression` is that of the single messages, which only the recording's `metadata.yaml` tells. Raises LogError
    where the file can't be opened, is damaged or not as rosbag2 writes it.
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
                raise damage_error(path, error) from error
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
