"""Opening SQLite files of rosbag2 as untrusted input: read only, without side effects, tables as rosbag2 makes them."""

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import quote

from fbench.replay.errors import LogError
from fbench.replay.logs.mcap.records import MAX_RECORD
from fbench.replay.logs.sniff import looks_like

_MAGIC = b"SQLite format 3\x00"
FAILURES = (sqlite3.Error, UnicodeDecodeError)
"""What `sqlite3` raises for damaged files; it can't decode the messages of some of its own errors."""
_ROW = 1024 * 1024
"""Room for what a row holds beside its longest value [byte]."""
_PRAGMAS = (
    "PRAGMA trusted_schema=OFF", "PRAGMA query_only=ON", "PRAGMA cell_size_check=ON", "PRAGMA cache_size=-16384",
)  # fmt: skip
_TABLES: Mapping[str, tuple[str, ...]] = {
    "topics": ("id", "name", "type", "serialization_format"),
    "messages": ("id", "topic_id", "timestamp", "data"),
}


@contextmanager
def connected(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a database for reading; text comes as bytes. Nothing is written beside the file.

    Raises:
        LogError: where it can't be opened, or isn't such a database.
    """
    _check_magic(path)
    uri = f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1"
    try:
        # Entries may be read ahead by another thread, though never by two at once.
        database = sqlite3.connect(uri, uri=True, isolation_level=None, check_same_thread=False)
    except FAILURES as error:
        raise damaged(path, error) from error
    with closing(database):
        database.text_factory = bytes
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_RECORD + _ROW)
        database.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
        try:
            for pragma in _PRAGMAS:
                database.execute(pragma)
        except FAILURES as error:
            raise damaged(path, error) from error
        yield database


def damaged(path: Path, error: Exception) -> LogError:
    """Return the error for a database that SQLite can't read."""
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

    Raises:
        LogError: naming the table.
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


def _check_magic(path: Path) -> None:
    try:
        with path.open("rb") as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise LogError(f"{path}: not an SQLite database (looks like {looks_like(file)})")
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error
