"""Read CSV, Parquet and Feather files: batches of rows with bounded memory, columns as arrays, rows by instant."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from fbench.replay.contracts.errors import LimitError, LogError
from fbench.replay.data.arrays import MAX_TEXT, Bool, Float64, Int64, Text, text_array
from fbench.replay.formats.text import stamp_of_seconds, track_number
from fbench.replay.logs.containers.parquet.footer import Chunk, DamageError, read_groups, read_tail, require_parsable
from fbench.replay.logs.containers.parquet.groups import read_page

KEYS = ("stamp_ns", "stamp_s", "frame")
ROW = "row"  # Column that is added: the number of each row, 1 for the first behind the header
_ROWS_AT_ONCE = 16384
_MAX_PAGES = 256 * 2**20
_PAGE_HEADER = 64 * 1024
_GROWING = (6, 7)  # DELTA_LENGTH_BYTE_ARRAY, DELTA_BYTE_ARRAY of parquet-format: few bytes stand for any text
_SEPARATORS = ",;\t"
_READ = pacsv.ReadOptions(use_threads=False, block_size=2**20)
_TEXTS = (pa.types.is_string, pa.types.is_large_string, pa.types.is_string_view)
_PLAIN = (pa.types.is_string, pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_null,
          pa.types.is_decimal, pa.types.is_timestamp)  # fmt: skip
_TRUE, _FALSE = ("true", "1", "yes", "1.0"), ("false", "0", "no", "0.0", "")
_AV2 = {
    "timestamp_ns": "stamp_ns", "tx_m": "x", "ty_m": "y", "tz_m": "z", "length_m": "length", "width_m": "width",
    "height_m": "height", "category": "label", "track_uuid": "track_id", "num_interior_pts": "num_lidar_pts",
    "log_id": "sequence",
}  # fmt: skip
"""Columns of Argoverse 2's annotations and submissions (https://argoverse.github.io/user-guide/tasks/3d_object_detection.html),
whose boxes are in the body's coordinates, too."""
_MAX_FEATHER = 512 * 2**20
_MAX_UNORDERED = 5_000_000
_MAX_AT_ONCE = 200_000


@dataclass(frozen=True)
class TableFile:
    """One file; columns by lower-case name."""

    path: Path
    names: dict[str, str]  # Name in the file, by the name in lower case
    types: dict[str, pa.DataType]
    separator: str | None  # Of a CSV; `None`: Parquet or Feather
    metadata: dict[bytes, bytes]

    @property
    def key(self) -> str:
        """Column that says when the boxes of a row were. Raises LogError where there is none."""
        for name in KEYS:
            if name in self.names:
                return name
        raise LogError(f"{self.path}: no column says when boxes were; expected {', '.join(KEYS[:-1])} or {KEYS[-1]}")

    @property
    def counts_frames(self) -> bool:
        """Whether the key is the frame, and not a stamp."""
        return self.key == "frame"

    def batches(self, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """Yield rows with their numbers, all columns or some. Raises LogError where the file is damaged."""
        wanted = list(self.names) if columns is None else list(columns)
        first = 1
        try:
            for batch in self._read([self.names[name] for name in wanted]):
                rows = pa.array(np.arange(first, first + batch.num_rows))
                first += batch.num_rows
                batch.validate(full=True)  # texts that aren't UTF-8
                columns_ = [batch.column(self.names[name]) for name in wanted]
                yield pa.table([*columns_, rows], names=[*wanted, ROW])
        except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
            raise LogError(f"{self.path}: can't be read ({str(error).splitlines()[0]})") from error

    def _read(self, names: list[str]) -> Iterator[pa.RecordBatch]:
        if self.separator is not None:
            # All columns as text: numbers are parsed later, so that stamps lose nothing and errors name their row.
            convert = pacsv.ConvertOptions(
                column_types=dict.fromkeys(names, pa.string()), include_columns=names, null_values=[""],
                strings_can_be_null=True, quoted_strings_can_be_null=True,
            )  # fmt: skip
            with pacsv.open_csv(self.path, _READ, pacsv.ParseOptions(delimiter=self.separator), convert) as reader:
                yield from reader
            return
        if _is_feather(self.path):
            with pa.OSFile(os.fsencode(self.path)) as source, pa.ipc.open_file(source) as file:
                for i in range(file.num_record_batches):
                    batch = file.get_batch(i).select(names)
                    for start in range(0, batch.num_rows, _ROWS_AT_ONCE):
                        yield batch.slice(start, _ROWS_AT_ONCE)
            return
        kinds = ((self.names[name], kind) for name, kind in self.types.items())
        texts = [n for n, kind in kinds if n in names and (pa.types.is_string(kind) or pa.types.is_large_string(kind))]
        with pq.ParquetFile(
            pa.OSFile(os.fsencode(self.path)), page_checksum_verification=True, pre_buffer=False,
            read_dictionary=texts,  # a text that is repeated takes room once
        ) as file:  # fmt: skip
            yield from file.iter_batches(_ROWS_AT_ONCE, columns=names, use_threads=False)


def open_table_file(path: Path) -> TableFile:
    """Read the names of a table's columns. Raises LogError where it isn't a table, or names a column twice."""
    try:
        if _is_feather(path):
            schema, separator = _feather_schema(path), None
        elif path.suffix.lower() == ".parquet":
            schema, separator = _schema(path), None
        else:
            separator = _separator(path)
            with pacsv.open_csv(path, _READ, pacsv.ParseOptions(delimiter=separator)) as reader:
                schema = reader.schema
        plain = [name.strip().lower() for name in schema.names]
        if "tx_m" in plain and "category" in plain:
            plain = [_AV2.get(name, name) for name in plain]
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise LogError(f"{path}: can't be read ({str(error).splitlines()[0]})") from error
    twice = next((name for name in plain if plain.count(name) > 1), None) if len(plain) < 10_000 else "?"
    if twice is not None or ROW in plain:
        raise LogError(f"{path}: column '{ROW if twice is None else twice}' is there twice, or not allowed")
    names = dict(zip(plain, schema.names, strict=True))
    return TableFile(path, names, dict(zip(plain, schema.types, strict=True)), separator, dict(schema.metadata or {}))


def _is_feather(path: Path) -> bool:
    return path.suffix.lower() == ".feather"


def _feather_schema(path: Path) -> pa.Schema:
    """Refuse files whose columns could take more memory than a table of boxes needs: they may be compressed."""
    size = path.stat().st_size
    if size > _MAX_FEATHER:
        raise LimitError(f"{path}: {size >> 20} MiB, more than {_MAX_FEATHER >> 20}; write Parquet", "LIM004")
    with pa.OSFile(os.fsencode(path)) as source, pa.ipc.open_file(source) as file:
        return file.schema


def _schema(path: Path) -> pa.Schema:
    """Refuse files that would take more memory than a table of boxes needs: bound what the pages of a row group take at
    one time, which is one page and the dictionary of each column.
    """
    with path.open("rb", buffering=0) as opened:
        size = os.fstat(opened.fileno()).st_size
        tail = read_tail(path, opened, size)
        require_parsable(path, tail)
        try:
            groups = read_groups(tail, size)  # pyarrow ends the process where statistics of a column are odd
        except DamageError as error:
            raise LogError(f"{path}: damaged footer ({error})") from error
        for group in groups:
            taken = sum(_largest(path, opened, chunk) for chunk in group.chunks)
            if taken > _MAX_PAGES:
                limit = f"over {_MAX_PAGES >> 20}; write smaller ones"
                raise LimitError(f"{path}: pages take {taken >> 20} MiB, {limit}", "LIM004")
        with pq.ParquetFile(opened) as file:
            return file.schema_arrow


def _largest(path: Path, file: FileIO, chunk: Chunk) -> int:
    """Bytes that the dictionary and the largest page of a column say that they take."""
    at, end = chunk.offset, chunk.offset + chunk.length
    dictionary = largest = 0
    while at < end:
        try:
            page = read_page(memoryview(os.pread(file.fileno(), min(_PAGE_HEADER, end - at), at)))
        except DamageError as error:
            raise LogError(f"{path}: column '{chunk.column}' is damaged ({error})") from error
        if page.encoding in _GROWING:
            raise LogError(f"{path}: column '{chunk.column}' is delta-coded text; write it as PLAIN")
        if page.is_dictionary:
            dictionary = page.unpacked
        largest = max(largest, page.unpacked)
        at += page.header + page.stored
    return dictionary + largest


def _separator(path: Path) -> str:
    with path.open("rb") as file:
        head = file.readline(2**16)
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise LogError(f"{path}: is UTF-16 text; save it as UTF-8")
    if not head.strip():
        raise LogError(f"{path}: is empty; expected a first line with the names of columns")
    return max(_SEPARATORS, key=lambda separator: head.count(separator.encode()))


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
        cast = self._cast(_drop_blank(self._column(name)), pa.float64(), name, "a number")
        there = np.asarray(cast.is_valid().to_numpy(zero_copy_only=False), bool)
        return np.asarray(cast.fill_null(np.nan).to_numpy(zero_copy_only=False), np.float64), there

    def wholes(self, name: str, absent: int = -1) -> Int64:
        """Return int64 (N,)."""
        column = self._column(name)
        if pa.types.is_timestamp(column.type):
            column = self._cast(column, pa.timestamp("ns"), name, "a stamp that fits nanoseconds").cast(pa.int64())
        cast = self._cast(_drop_blank(column), pa.int64(), name, "a whole number")
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

    def keys(self, name: str) -> Int64:
        """Return stamps [ns] or frames (N,), by the key of the table. Raises LogError naming a row without any."""
        if name == "stamp_ns" and pa.types.is_floating(self.table.column(name).type):
            raise LogError(f"{self.path}: stamp_ns is a float, which loses nanoseconds; store it as int64")
        if name == "stamp_s":
            stamps = self._each(name, lambda text: stamp_of_seconds(text) if text else -1, "seconds")
            found = np.array(stamps, np.int64)
        else:
            found = self.wholes(name)
        if len(found) and found.min() < 0:
            raise LogError(f"{self.where(int(np.argmax(found < 0)))}: {name} is missing or negative")
        return found

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
        column = self._column(name)
        try:
            values = column.to_pylist()
        except (pa.ArrowException, ValueError, OverflowError) as error:
            raise LogError(f"{self.path}: column '{name}' is {column.type}, and can't be read ({error})") from error
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
                    given = value.value if pa.types.is_timestamp(column.type) else value.as_py()
                    raise self._wrong(name, index, str(given), expected) from None
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
        if not any(check(column.type) for check in _PLAIN):
            raise LogError(f"{self.path}: column '{name}' is {column.type}, expected single values")
        return column

    def _require_short(self, name: str, column: pa.Array) -> None:
        if not any(check(column.type) for check in _TEXTS) or not len(column):
            return
        longest = pc.max(pc.binary_length(column)).as_py() or 0
        if longest > 4 * MAX_TEXT:  # bytes of UTF-8
            raise LimitError(f"{self.path}: column '{name}' has a text of {longest} bytes, more than {4 * MAX_TEXT}")


def _drop_blank(column: pa.Array) -> pa.Array:
    """Trim texts, and take empty ones for unknown."""
    if not pa.types.is_string(column.type):
        return column
    column = pc.utf8_trim_whitespace(column)
    return pc.if_else(pc.equal(column, ""), pa.scalar(None, pa.string()), column)


def instants(file: TableFile) -> Iterator[tuple[Int64, Values]]:
    """Yield rows with their keys, ascending, never parting those of one instant. LimitError: too many at once."""
    num_rows, last, is_ordered = 0, -1, True
    for batch in file.batches([file.key]):
        keys = Values(file.path, batch).keys(file.key)
        if len(keys):
            is_ordered = is_ordered and int(keys[0]) >= last and bool((np.diff(keys) >= 0).all())
            last, num_rows = int(keys[-1]), num_rows + len(keys)
    if not is_ordered and num_rows > _MAX_UNORDERED:
        raise LimitError(f"{file.path}: {num_rows} rows that aren't in the order of '{file.key}'; sort them")
    kept: pa.Table | None = None
    for batch in file.batches() if is_ordered else _sort_rows(file):
        table = batch if kept is None else pa.concat_tables([kept, batch])
        values = Values(file.path, table)
        keys = values.keys(file.key)
        last = int(np.searchsorted(keys, keys[-1])) if len(keys) else 0
        if len(keys) - last > _MAX_AT_ONCE:
            raise LimitError(f"{file.path}: over {_MAX_AT_ONCE} rows at '{file.key}' {keys[-1]}")
        if last:
            yield keys[:last], Values(file.path, table.slice(0, last))
        kept = table.slice(last)
    if kept is not None and kept.num_rows:
        values = Values(file.path, kept)
        yield values.keys(file.key), values


def _sort_rows(file: TableFile) -> Iterator[pa.Table]:
    table = pa.concat_tables(list(file.batches()))
    order = np.argsort(Values(file.path, table).keys(file.key), kind="stable")
    for start in range(0, len(order), _ROWS_AT_ONCE):
        yield table.take(pa.array(order[start : start + _ROWS_AT_ONCE]))
