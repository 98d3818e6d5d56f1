"""Columns of a table as arrays, and its rows by instant; errors name file, row and column."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from fbench.replay.contracts.errors import LimitError, LogError
from fbench.replay.data.arrays import MAX_TEXT, Bool, Float64, Int64, Text, text_array
from fbench.replay.formats.table_files import ROW, TableFile
from fbench.replay.formats.text import stamp_of_seconds, track_number

_TRUE, _FALSE = ("true", "1", "yes", "1.0"), ("false", "0", "no", "0.0", "")


@dataclass(frozen=True)
class Values:
    """Some rows of a table."""

    path: Path
    table: pa.Table

    def __len__(self) -> int:
        return int(self.table.num_rows)

    def __contains__(self, name: str) -> bool:
        return name in self.table.column_names

    def where(self, index: int) -> str:
        """For errors: file and row."""
        return f"{self.path} row {self.table.column(ROW)[index].as_py()}"

    def numbers(self, name: str) -> tuple[Float64, Bool]:
        """Return float64 (N,), NaN where there is none, and where there is one (also one that isn't finite)."""
        column = self._column(name)
        if pa.types.is_string(column.type):
            column = pc.utf8_trim_whitespace(column)
            column = pc.if_else(pc.equal(column, ""), pa.scalar(None, pa.string()), column)
        cast = self._cast(column, pa.float64(), name, "a number")
        there = np.asarray(cast.is_valid().to_numpy(zero_copy_only=False), bool)
        return np.asarray(cast.fill_null(np.nan).to_numpy(zero_copy_only=False), np.float64), there

    def wholes(self, name: str, absent: int = -1) -> Int64:
        """Return int64 (N,)."""
        column = self._column(name)
        if pa.types.is_timestamp(column.type):
            column = self._cast(column, pa.timestamp("ns"), name, "a stamp that fits nanoseconds").cast(pa.int64())
        if pa.types.is_string(column.type):
            column = pc.utf8_trim_whitespace(column)
            column = pc.if_else(pc.equal(column, ""), pa.scalar(None, pa.string()), column)
        cast = self._cast(column, pa.int64(), name, "a whole number")
        return np.asarray(cast.fill_null(absent).to_numpy(zero_copy_only=False), np.int64)

    def texts(self, name: str) -> Text:
        """Return texts (N,), empty where there is none."""
        return text_array([text.strip() for text in self._texts(name)])

    def flags(self, name: str) -> Bool:
        """Return bool (N,), false where there is none."""
        column = self._column(name)
        if pa.types.is_boolean(column.type):
            return np.asarray(column.fill_null(False).to_numpy(zero_copy_only=False), bool)

        def read(text: str) -> bool:
            if text.lower() not in (*_TRUE, *_FALSE):
                raise ValueError(text)
            return text.lower() in _TRUE

        return np.array(self._each(name, read, "true or false"), bool)

    def ids(self, name: str) -> Int64:
        """Return track ids (N,), -1 where there is none; texts get numbers of their own."""
        if pa.types.is_integer(self._column(name).type):
            return np.maximum(self.wholes(name), -1)
        return np.array(self._each(name, track_number, "an id"), np.int64)

    def seconds(self, name: str) -> Int64:
        """Return stamps [ns] (N,) from seconds, -1 where there are none."""
        return np.array(self._each(name, lambda text: stamp_of_seconds(text) if text else -1, "seconds"), np.int64)

    def _each(self, name: str, read: Callable[[str], Any], expected: str) -> list[Any]:
        """Read each different text once."""
        known: dict[str, Any] = {}
        texts = [text.strip() for text in self._texts(name)]
        for index, text in enumerate(texts):
            if text not in known:
                try:
                    known[text] = read(text)
                except ValueError:
                    raise self._wrong(name, index, text, expected) from None
        return [known[text] for text in texts]

    def _texts(self, name: str) -> Iterable[str]:
        values = self._column(name).to_pylist()
        return ("" if value is None else value if isinstance(value, str) else repr(value) if isinstance(value, float)
                else str(value) for value in values)  # fmt: skip

    def _cast(self, column: pa.Array, kind: pa.DataType, name: str, expected: str) -> pa.Array:
        try:
            return column.cast(kind)
        except pa.ArrowException:
            for index, value in enumerate(column):
                try:
                    value.cast(kind)
                except pa.ArrowException:
                    told = value.value if pa.types.is_timestamp(column.type) else value.as_py()
                    raise self._wrong(name, index, str(told), expected) from None
            raise LogError(f"{self.path}: column '{name}' is {column.type}, expected {expected}") from None

    def _wrong(self, name: str, index: int, text: str, expected: str) -> LogError:
        return LogError(f"{self.where(index)}: {name} is '{text[:40]}', expected {expected}")

    def _column(self, name: str) -> pa.Array:
        column = self.table.column(name).combine_chunks()
        if isinstance(column, pa.ChunkedArray):
            column = pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], column.type)
        if pa.types.is_dictionary(column.type):
            self._require_short(name, column.dictionary)  # each of its rows repeats an entry
            column = column.dictionary_decode()
        self._require_short(name, column)
        if pa.types.is_large_string(column.type) or pa.types.is_string_view(column.type):
            column = column.cast(pa.string())
        if not _is_plain(column.type):
            raise LogError(f"{self.path}: column '{name}' is {column.type}, expected single values")
        return column

    def _require_short(self, name: str, column: pa.Array) -> None:
        if not _is_text(column.type) or not len(column):
            return
        longest = pc.max(pc.binary_length(column)).as_py() or 0
        if longest > 4 * MAX_TEXT:  # bytes of UTF-8
            raise LimitError(f"{self.path}: column '{name}' has a text of {longest} bytes, more than {4 * MAX_TEXT}")


def _is_text(kind: pa.DataType) -> bool:
    checks = (pa.types.is_string, pa.types.is_large_string, pa.types.is_string_view)
    return any(check(kind) for check in checks)


def _is_plain(kind: pa.DataType) -> bool:
    checks = (pa.types.is_string, pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_null,
              pa.types.is_decimal, pa.types.is_timestamp)  # fmt: skip
    return any(check(kind) for check in checks)


KEYS = ("stamp_ns", "stamp_s", "frame")
_MAX_UNORDERED = 5_000_000
_MAX_AT_ONCE = 200_000
_ROWS_AT_ONCE = 16384


@dataclass(frozen=True)
class Key:
    """What says when the boxes of a row were."""

    name: str

    @property
    def is_frame(self) -> bool:
        """Whether frames are counted."""
        return self.name == "frame"

    def read(self, values: Values) -> Int64:
        """Return stamps [ns] or frames (N,).

        Raises:
            LogError: naming the row where there is none.
        """
        if self.name == "stamp_ns" and pa.types.is_floating(values.table.column("stamp_ns").type):
            raise LogError(f"{values.path}: stamp_ns is a float, which loses nanoseconds; store it as int64")
        found = values.seconds(self.name) if self.name == "stamp_s" else values.wholes(self.name)
        if len(found) and found.min() < 0:
            index = int(np.argmax(found < 0))
            raise LogError(f"{values.where(index)}: {self.name} is missing or negative")
        return found


def key_of(file: TableFile) -> Key:
    """Return the column that says when boxes were.

    Raises:
        LogError: where there is none.
    """
    name = next((name for name in KEYS if name in file.names), None)
    if name is None:
        raise LogError(f"{file.path}: no column says when boxes were; expected {', '.join(KEYS[:-1])} or {KEYS[-1]}")
    return Key(name)


def instants(file: TableFile, key: Key) -> Iterator[tuple[Int64, Values]]:
    """Yield rows with their keys, ascending, never parting those of one instant.

    Raises:
        LimitError: where more rows than memory allows aren't in order, or belong to one instant.
    """
    num_rows, is_ordered = _survey(file, key)
    if is_ordered:
        batches: Iterator[pa.Table] = file.batches()
    elif num_rows > _MAX_UNORDERED:
        raise LimitError(f"{file.path}: {num_rows} rows that aren't in the order of '{key.name}'; sort them")
    else:
        batches = _ordered(file, key)
    kept: pa.Table | None = None
    for batch in batches:
        table = batch if kept is None else pa.concat_tables([kept, batch])
        values = Values(file.path, table)
        keys = key.read(values)
        last = int(np.searchsorted(keys, keys[-1])) if len(keys) else 0
        if len(keys) - last > _MAX_AT_ONCE:
            raise LimitError(f"{file.path}: over {_MAX_AT_ONCE} rows at '{key.name}' {keys[-1]}")
        if last:
            yield keys[:last], Values(file.path, table.slice(0, last))
        kept = table.slice(last)
    if kept is not None and kept.num_rows:
        values = Values(file.path, kept)
        yield key.read(values), values


def _survey(file: TableFile, key: Key) -> tuple[int, bool]:
    """Count the rows, and tell whether they are in order."""
    num_rows, last, is_ordered = 0, -1, True
    for batch in file.batches([key.name]):
        keys = key.read(Values(file.path, batch))
        if len(keys):
            is_ordered = is_ordered and int(keys[0]) >= last and bool((np.diff(keys) >= 0).all())
            last, num_rows = int(keys[-1]), num_rows + len(keys)
    return num_rows, is_ordered


def _ordered(file: TableFile, key: Key) -> Iterator[pa.Table]:
    table = pa.concat_tables(list(file.batches()))
    order = np.argsort(key.read(Values(file.path, table)), kind="stable")
    for start in range(0, len(order), _ROWS_AT_ONCE):
        yield table.take(pa.array(order[start : start + _ROWS_AT_ONCE]))
