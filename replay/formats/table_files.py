"""CSV and Parquet files as batches of rows, with bounded memory."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from fbench.replay.contracts.errors import LimitError, LogError
from fbench.replay.logs.containers.parquet.footer import DamageError, read_tail, require_parsable
from fbench.replay.logs.containers.parquet.groups import read_page

SUFFIXES = (".csv", ".tsv", ".parquet")
ROW = "row"
"""Column that is added: the number of each row, 1 for the first behind the header."""
_ROWS_AT_ONCE = 16384
_MAX_PAGES = 256 * 2**20
_PAGE_HEADER = 64 * 1024
_GROWING = (6, 7)
"""DELTA_LENGTH_BYTE_ARRAY and DELTA_BYTE_ARRAY of parquet-format: a few bytes may stand for any amount of text."""
_SEPARATORS = ",;\t"


@dataclass(frozen=True)
class TableFile:
    """One file; columns by lower-case name."""

    path: Path
    names: dict[str, str]
    """Name in the file, by the name in lower case."""
    types: dict[str, pa.DataType]
    separator: str | None
    """Of a CSV; `None`: Parquet."""
    metadata: dict[bytes, bytes]

    def batches(self, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """Yield rows with their numbers, all columns or some.

        Raises:
            LogError: where the file is damaged.
        """
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
            yield from _csv(self.path, self.separator, names)
            return
        texts = [
            self.names[name]
            for name, kind in self.types.items()
            if bool(pa.types.is_string(kind) or pa.types.is_large_string(kind)) and self.names[name] in names
        ]
        with pq.ParquetFile(
            self.path, page_checksum_verification=True, pre_buffer=False,
            read_dictionary=texts,  # a text that is repeated takes room once
        ) as file:  # fmt: skip
            yield from file.iter_batches(_ROWS_AT_ONCE, columns=names, use_threads=False)


def open_table_file(path: Path) -> TableFile:
    """Read the names of a table's columns.

    Raises:
        LogError: where it isn't a table, or names a column twice.
    """
    try:
        if path.suffix.lower() == ".parquet":
            schema = _schema(path)
            separator = None
        else:
            separator = _separator(path)
            with pacsv.open_csv(path, _read_options(), _parse_options(separator)) as reader:
                schema = reader.schema
        plain = [name.strip().lower() for name in schema.names]
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise LogError(f"{path}: can't be read ({str(error).splitlines()[0]})") from error
    twice = next((name for name in plain if plain.count(name) > 1), None) if len(plain) < 10_000 else "?"
    if twice is not None or ROW in plain:
        raise LogError(f"{path}: column '{ROW if twice is None else twice}' is there twice, or not allowed")
    names = dict(zip(plain, schema.names, strict=True))
    return TableFile(path, names, dict(zip(plain, schema.types, strict=True)), separator, dict(schema.metadata or {}))


def _schema(path: Path) -> pa.Schema:
    """Refuse files that would take more memory than a table of boxes needs."""
    with path.open("rb", buffering=0) as opened:
        tail = read_tail(path, opened, os.fstat(opened.fileno()).st_size)
        require_parsable(path, tail)
        with pq.ParquetFile(opened) as file:
            groups = [file.metadata.row_group(i) for i in range(file.metadata.num_row_groups)]
            for group in groups:
                _require_small(path, opened, group)
            return file.schema_arrow


def _require_small(path: Path, file: BinaryIO, group: Any) -> None:
    """Bound what the pages of a row group take at one time: one page and the dictionary of each column."""
    size = 0
    for i in range(group.num_columns):
        try:
            size += _largest(path, file, group.column(i))
        except DamageError as error:
            raise LogError(f"{path}: column '{group.column(i).path_in_schema}' is damaged ({error})") from error
    if size > _MAX_PAGES:
        raise LimitError(f"{path}: pages take {size >> 20} MiB, over {_MAX_PAGES >> 20}; write smaller ones", "LIM004")


def _largest(path: Path, file: BinaryIO, chunk: Any) -> int:
    """Bytes that the dictionary and the largest page of a column say that they take."""
    starts = [at for at in (chunk.dictionary_page_offset, chunk.data_page_offset) if at]
    at = min(starts, default=0)
    end = at + chunk.total_compressed_size
    dictionary = largest = 0
    while at < end:
        page = read_page(memoryview(os.pread(file.fileno(), min(_PAGE_HEADER, end - at), at)))
        if page.encoding in _GROWING:
            raise LogError(f"{path}: column '{chunk.path_in_schema}' is delta-coded text; write it as PLAIN")
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


def _read_options() -> pacsv.ReadOptions:
    return pacsv.ReadOptions(use_threads=False, block_size=2**20)


def _parse_options(separator: str) -> pacsv.ParseOptions:
    return pacsv.ParseOptions(delimiter=separator)


def _csv(path: Path, separator: str, names: list[str]) -> Iterator[pa.RecordBatch]:
    """All columns as text: numbers are parsed later, so that stamps lose nothing and errors name their row."""
    convert = pacsv.ConvertOptions(
        column_types=dict.fromkeys(names, pa.string()), include_columns=names, null_values=[""],
        strings_can_be_null=True, quoted_strings_can_be_null=True,
    )  # fmt: skip
    with pacsv.open_csv(path, _read_options(), _parse_options(separator), convert) as reader:
        yield from reader
