"""One SQLite file (`.db3`) of a rosbag2 recording as a container, opened as untrusted input."""

import os
import sqlite3
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
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
from fbench.replay.data.scores import format_count
from fbench.replay.logs.container import Channel, Entry, Schema
from fbench.replay.logs.containers.limits import StoredLog, looks_like
from fbench.replay.logs.containers.mcap.records import MAX_RECORD, RecordError, check_size
from fbench.replay.logs.containers.rosbag.zstd import check_format, is_packed, unpack_message

_MAGIC = b"SQLite format 3\x00"
FAILURES = (sqlite3.Error, UnicodeDecodeError)
"""What `sqlite3` raises for damaged files; it can't decode the messages of some of its own errors."""
_ROW = 1024 * 1024  # Room for what a row holds beside its longest value [byte]
_MAX_TOPICS = 2**16 - 1
_MAX_TEXT = 4 * 1024 * 1024  # Longer names, definitions and profiles are refused [byte]
_MAX_TEXTS = 256 * 1024 * 1024  # Topics may have no more of them in all, nor may definitions [byte]
_PRAGMAS = ("trusted_schema=OFF", "query_only=ON", "cell_size_check=ON", "cache_size=-16384")
_TABLES: Mapping[str, tuple[str, ...]] = {
    "topics": ("id", "name", "type", "serialization_format"),
    "messages": ("id", "topic_id", "timestamp", "data"),
}
KEYS = "SELECT timestamp, id FROM messages ORDER BY timestamp, id"
"""Walks the index of timestamps where there is one; else SQLite sorts these two numbers, on disk if need be."""
_KEYS_FROM = "SELECT timestamp, id FROM messages WHERE timestamp >= ? ORDER BY timestamp, id"
_TABLE = "SELECT timestamp, id, topic_id FROM messages NOT INDEXED ORDER BY id"
_HEAD = "SELECT timestamp, topic_id, CASE typeof(data) WHEN 'blob' THEN length(data) END FROM messages WHERE id = ?"
_DATA = "SELECT data FROM messages WHERE id = ?"


@contextmanager
def _report_damage(path: Path) -> Iterator[None]:
    """Raise LogError for a database that SQLite can't read."""
    try:
        yield
    except FAILURES as error:
        advice = f"`sqlite3 {path.name} .recover` may save what is left"
        raise LogError(f"{path}: damaged database ({error}); {advice}") from error


def _columns(database: sqlite3.Connection, table: str) -> Mapping[str, bool]:
    """Stored columns of a table, and whether each is the integer key of its rows; empty where there is none of that
    name, or a view or a virtual one.
    """
    query = "SELECT count(*) FROM sqlite_master WHERE lower(name) = ? AND type = 'table' AND rootpage > 0"
    if not database.execute(query, (table,)).fetchone()[0]:
        return {}
    rows = database.execute("SELECT name, type, hidden, pk FROM pragma_table_xinfo(?)", (table,)).fetchall()
    return {
        name.decode("utf-8", "replace").lower(): bool(pk) and kind.upper() == b"INTEGER"
        for name, kind, hidden, pk in rows
        if not hidden
    }


def _check_tables(database: sqlite3.Connection, path: Path) -> None:
    """Refuse databases whose tables aren't as rosbag2 makes them: views and computed columns run what others wrote.
    Raises LogError naming the table.
    """
    for table, wanted in _TABLES.items():
        found = _columns(database, table)
        missing = next((name for name in wanted if name not in found), None)
        if not found:
            reason = f"no table '{table}'"
        elif missing is not None:
            reason = f"table '{table}' has no column '{missing}'"
        elif not found["id"]:
            reason = f"table '{table}' isn't keyed by its id"
        else:
            continue
        raise LogError(f"{path}: not a recording of rosbag2 ({reason})")


def _read_channels(
    database: sqlite3.Connection, path: Path, skipped: Callable[[int, str], None]
) -> Mapping[int, Channel]:
    """Read all topics; `skipped` is told the id of each that is damaged, with the reason. Raises LogError where there
    are more than the limit.
    """
    definitions = _read_definitions(database, path)
    found = _columns(database, "topics")
    optional = [name for name in ("offered_qos_profiles", "type_description_hash") if name in found]
    names = ", ".join(["id", *map(_text, ("name", "type", "serialization_format", *optional))])
    rows = database.execute(f"SELECT {names} FROM topics ORDER BY id LIMIT {_MAX_TOPICS + 1}")  # noqa: S608
    channels: dict[int, Channel] = {}
    for number, *texts in _bound(rows, path):
        if len(channels) == _MAX_TOPICS:
            raise LogError(f"{path}: more than {_MAX_TOPICS} topics")
        name, kind, encoding, *more = texts
        if name is None or kind is None or encoding is None:
            skipped(number, f"name, type or format of topic {number} is no text of up to {_MAX_TEXT} bytes")
            continue
        metadata = {key: _decode(text) for key, text in zip(optional, more, strict=True) if text}
        digest = metadata.get("type_description_hash", "").encode()
        schema = definitions.get((kind, digest)) or definitions.get((kind, b"")) or Schema(_decode(kind), "", b"")
        # Some writers leave the format empty; ROS 2 has no other one.
        channels[number] = Channel(_decode(name), _decode(encoding) or "cdr", schema, metadata)
    return channels


def _read_definitions(database: sqlite3.Connection, path: Path) -> Mapping[tuple[bytes, bytes], Schema]:
    """Definitions by type and hash, the first of each, and by type alone."""
    found = _columns(database, "message_definitions")
    needed = ("topic_type", "encoding", "encoded_message_definition")
    if not found.keys() >= set(needed):
        return {}
    digest = _text("type_description_hash") if "type_description_hash" in found else "NULL"
    names = ", ".join([*map(_text, needed), digest])
    definitions: dict[tuple[bytes, bytes], Schema] = {}
    rows = database.execute(f"SELECT {names} FROM message_definitions LIMIT {_MAX_TOPICS}")  # noqa: S608
    for kind, encoding, text, hashed in _bound(rows, path):
        if kind and encoding and text:
            schema = Schema(_decode(kind), _decode(encoding), text)
            definitions.setdefault((kind, hashed or b""), schema)
            definitions.setdefault((kind, b""), schema)
    return definitions


def _bound(rows: Iterable[tuple[Any, ...]], path: Path) -> Iterator[tuple[Any, ...]]:
    """Yield the rows. Raises LogError where their texts take more than the limit."""
    left = _MAX_TEXTS
    for row in rows:
        left -= sum(len(text) for text in row if isinstance(text, bytes))
        if left < 0:
            raise LogError(f"{path}: topics and definitions have more than the limit of {_MAX_TEXTS} bytes")
        yield row


def _text(column: str) -> str:
    """Expression for a column that is `NULL` unless it is text of bearable length."""
    # SQLite counts text in characters, and only up to the first NUL.
    size = f"length(CAST({column} AS BLOB))"
    return f"CASE WHEN typeof({column}) = 'text' AND {size} <= {_MAX_TEXT} THEN {column} END"


def _decode(text: bytes) -> str:
    return text.decode("utf-8", "backslashreplace")


class _Head(NamedTuple):
    """All of a message but its payload."""

    log_ns: int
    row: int
    channel: int
    size: int | None  # Of the payload [byte]; `None`: it isn't binary


class Db3File(StoredLog):
    """Finds and reads the messages of a file; each fault is counted once, however often it is met.

    `compression` is that of the single messages, which the recording's `metadata.yaml` tells; without it, messages in
    zstd are found by how they begin. Raises LogError where the file can't be opened, is damaged or not as rosbag2
    writes it.
    """

    keeps_checksums = False

    def __init__(self, path: Path, faults: FaultLog, compression: str = "") -> None:
        check_format(path, compression)
        super().__init__(path, faults)
        self._is_packed = compression == "zstd"
        self._times: Mapping[int, Int64] | None = None
        with self._connect() as database, _report_damage(path):
            _check_tables(database, path)
            self.channels = _read_channels(database, path, lambda row, why: self.once("LOG008", (row,), why))
        for suffix in ("-wal", "-journal"):  # of a recorder that was killed; nothing here may change the file
            journal = path.with_name(path.name + suffix)
            if journal.is_file() and journal.stat().st_size:
                advice = f"`sqlite3 {path.name} VACUUM` on a copy of both merges it"
                self.once("LOG002", (suffix,), f"messages in {journal.name} aren't read; {advice}")
        for number, channel in self.channels.items():
            if "\\" in channel.topic + channel.schema_name:  # which no name of ROS has
                self.once("LOG010", (number,), f"topic {number}, '{channel.topic}'")
        self.once("LOG006", (), "SQLite keeps no checksums of messages")

    @contextmanager
    def _connect(self) -> Iterator[sqlite3.Connection]:
        """Open the database for reading; text comes as bytes. Nothing is written beside the file. Raises LogError where
        it can't be opened, or isn't such a database.
        """
        with self._open() as file:
            head = file.read(100)
            if not head.startswith(_MAGIC):
                raise LogError(f"{self.path}: not an SQLite database (looks like {looks_like(file)})")
            size, page = file.seek(0, os.SEEK_END), int.from_bytes(head[16:18], "big")
        with _report_damage(self.path):
            # SQLite refuses files that lack whole pages, but fills up a part of a page with zeros. A size of 1 stands
            # for 65536: https://www.sqlite.org/fileformat.html, 1.3.2
            if page and size % (65536 if page == 1 else page):
                raise sqlite3.DatabaseError(f"it ends within a page, after {size} bytes")
        uri = f"file:{quote(str(self.path.absolute()))}?mode=ro&immutable=1"
        with _report_damage(self.path):
            # Entries may be read ahead by another thread, though never by two at once.
            database = sqlite3.connect(uri, uri=True, isolation_level=None, check_same_thread=False)
        with closing(database):
            database.text_factory = bytes
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_RECORD + _ROW)
            database.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
            with _report_damage(self.path):
                for pragma in _PRAGMAS:
                    database.execute(f"PRAGMA {pragma}")
            yield database

    @property
    def counts(self) -> Mapping[int, int]:
        """Messages of each topic; reads the whole table, though not the messages in it."""
        return {number: len(times) for number, times in self.log_times().items()}

    def log_times(self) -> Mapping[int, Int64]:
        """`log_ns` of each topic's messages, ascending; reads the whole table, though not the messages in it."""
        if self._times is not None:
            return self._times
        times = {number: array("q") for number in self.channels}
        unknown: Counter[int] = Counter()
        with self._connect() as database:
            for log_ns, _, channel in self._rows(database, _TABLE):
                if not isinstance(channel, int):
                    continue  # counted where it is met in the order of time
                if channel in times:
                    times[channel].append(log_ns)
                else:
                    unknown[channel] += 1
        for channel, num in sorted(unknown.items()):
            self.once("LOG008", (channel,), f"{format_count(num, 'message')} of unknown topic {channel}")
        self._times = {number: np.sort(np.frombuffer(found, np.int64)) for number, found in times.items()}
        return self._times

    def entries(self, channels: frozenset[int], start_ns: int | None = None) -> Iterator[Entry]:
        """All messages of these topics, or those from a log time on, in canonical order; damaged ones are skipped and
        counted.
        """
        query, values = (KEYS, ()) if start_ns is None else (_KEYS_FROM, (start_ns,))
        wanted = {number: self.channels[number].topic for number in channels & self.channels.keys()}
        num = 0
        with self._connect() as database, closing(database.cursor()) as cursor:
            for _, ties in groupby(self._rows(database, query, values), key=itemgetter(0)):
                heads = [head for head in self._heads(cursor, ties) if head.channel in wanted]
                heads.sort(key=lambda head: (wanted[head.channel], head.row))
                num += len(heads)
                for log_ns, row, channel, size in heads:
                    check_size(f"{self.path}: row {row}", size or 0)
                    try:
                        if size is None:
                            raise RecordError("its data aren't binary")
                        data = memoryview(cursor.execute(_DATA, (row,)).fetchone()[0])
                        # Without `metadata.yaml`, only the message itself says that it is compressed.
                        packed = self._is_packed or is_packed(data, self.channels[channel].encoding)
                        data = unpack_message(data) if packed else data
                    except (RecordError, *FAILURES) as error:
                        self._lose(row, log_ns, error)
                    else:
                        yield Entry(log_ns, wanted[channel], 0, 0, row, channel, 0, log_ns, data)
        if start_ns is None:
            expected = sum(len(self.log_times()[number]) for number in wanted)
            if num != expected:
                where = f"the index of timestamps tells of {num} messages, the table of {expected}"
                self.once("LOG004", ("index",), where)

    def _rows(
        self, database: sqlite3.Connection, query: str, values: tuple[int, ...] = ()
    ) -> Iterator[tuple[Any, ...]]:
        """Stamp and id of all messages, and what else the query selects; ends at damage, which is counted."""
        last: tuple[int, ...] | None = None
        broken: tuple[str, int | None] | None = None  # Why, and the last good stamp
        try:
            for found in database.execute(query, values):
                log_ns, row = found[:2]
                if not isinstance(log_ns, int) or log_ns < 0:
                    self._lose(row, log_ns, "no such stamp")
                    continue
                at = (row,) if query == _TABLE else (log_ns, row)
                if last is not None and at <= last:  # as in a tree of pages that goes in a circle
                    broken = f"row {row} is out of order", log_ns
                    break
                last = at
                yield found
        except FAILURES as error:
            broken = str(error), last[0] if last is not None and query != _TABLE else None
        if broken is not None:
            reason, last_ns = broken
            stamp = "unknown" if last_ns is None else last_ns
            self.once("LOG002", ("table",), f"database is damaged ({reason}), last good stamp {stamp}")

    def _lose(self, row: int, log_ns: object, reason: object) -> None:
        self.once("LOG004", ("row", row), f"row {row} at {log_ns}: {reason}")

    def _heads(self, cursor: sqlite3.Cursor, keys: Iterable[tuple[Any, ...]]) -> Iterator[_Head]:
        for log_ns, row in keys:
            try:
                found = cursor.execute(_HEAD, (row,)).fetchone()
                if found is None or found[0] != log_ns:
                    raise RecordError("the index of timestamps doesn't fit the table")
                _, channel, size = found
                if not isinstance(channel, int):
                    raise RecordError("its topic is no number")
            except (RecordError, *FAILURES) as error:
                self._lose(row, log_ns, error)
            else:
                yield _Head(log_ns, row, channel, size)
