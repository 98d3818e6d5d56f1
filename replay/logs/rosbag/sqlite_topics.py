"""Topics of a rosbag2 SQLite file as channels."""

import sqlite3
from collections.abc import Callable, Mapping
from pathlib import Path

from fbench.replay.errors import LogError
from fbench.replay.logs.container import Channel, Schema
from fbench.replay.logs.rosbag.sqlite_open import columns, is_table

_MAX_TOPICS = 2**16 - 1
_MAX_TEXT = 4 * 1024 * 1024
"""Longer names, definitions and profiles are refused [byte]."""
_MAX_TEXTS = 256 * 1024 * 1024
_Definitions = Mapping[tuple[bytes, bytes], Schema]
Count = Callable[[int, str], None]


def read_channels(database: sqlite3.Connection, path: Path, skipped: Count) -> Mapping[int, Channel]:
    """Read all topics; `skipped` is told the id of each that is damaged, with the reason.

    Raises:
        LogError: where there are more than the limit.
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
        metadata = {key: _decoded(text) for key, text in zip(optional, more, strict=True) if text}
        digest = metadata.get("type_description_hash", "").encode()
        schema = definitions.get((kind, digest)) or definitions.get((kind, b"")) or Schema(_decoded(kind), "", b"")
        channels[number] = Channel(_decoded(name), _decoded(encoding), schema, metadata)
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
            schema = Schema(_decoded(kind), _decoded(encoding), text)
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


def _decoded(text: bytes) -> str:
    return text.decode("utf-8", "backslashreplace")
