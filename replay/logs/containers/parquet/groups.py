"""Reading of one row group: bytes are verified and their claims bounded before pyarrow sees them.

pyarrow takes the sizes that a file claims. A damaged or hostile file can claim anything, so they are bounded first.
Ids of fields are those of `PageHeader` in parquet-format.
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fbench.replay.contracts.errors import LimitError, LogError
from fbench.replay.data.arrays import Int64
from fbench.replay.logs.containers.limits import MAX_STAMP_NS, crc32
from fbench.replay.logs.containers.parquet import footer as footers
from fbench.replay.logs.containers.parquet.footer import Chunk, DamageError, Footer, open_regular, reason_of
from fbench.replay.logs.containers.parquet.log_json import GroupEntries

MAX_DECODED = 256 * 1024 * 1024
"""Row groups that would take more are read piece by piece; what can't be cut into such pieces is refused [byte]."""
_PART = MAX_DECODED // 4
_UNPACKED, _STORED = 2, 3
_DATA, _DICTIONARY, _DATA_V2 = 5, 7, 8
_NUM_VALUES, _ENCODING, _ENCODING_V2 = 1, 2, 4
_PLAIN = 0
_DICTIONARY_CODES = (2, 8)
_GROWING = {6: "DELTA_LENGTH_BYTE_ARRAY", 7: "DELTA_BYTE_ARRAY"}
_PER_VALUE = 16  # At least so many bytes are taken for a value: offset, level, number
_HEADER = 64 * 1024
_INDEX = "log_ns"


class Page(NamedTuple):
    """What the header of a page says."""

    header: int  # Size of the header [byte]
    stored: int
    unpacked: int
    num_values: int
    encoding: int
    is_dictionary: bool


def read_page(data: memoryview) -> Page:
    """Read the page header at the start of `data`. Raises DamageError where there is none."""
    fields, end = footers.read_struct(data)
    unpacked, stored = footers.get(fields, _UNPACKED, int), footers.get(fields, _STORED, int)
    kind = next((k for k in (_DATA, _DICTIONARY, _DATA_V2) if k in fields), None)
    if kind is None:  # an index page has no values
        return Page(end, stored, unpacked, 0, _PLAIN, False)
    inner = footers.get(fields, kind, dict)
    encoding = footers.get(inner, _ENCODING_V2 if kind == _DATA_V2 else _ENCODING, int)
    return Page(end, stored, unpacked, footers.get(inner, _NUM_VALUES, int), encoding, kind == _DICTIONARY)


class _Pieces:
    """Bytes that were read and verified, as the file that pyarrow wants; there is nothing between the pieces."""

    def __init__(self, pieces: Sequence[tuple[int, memoryview]], size: int) -> None:
        self._pieces, self._size, self._at = pieces, size, 0  # Offset and content of each; size of the file
        self.closed = False

    def seek(self, at: int, whence: int = 0) -> int:
        self._at = at + (0, self._at, self._size)[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def read(self, length: int = -1) -> memoryview:
        """Return the bytes of one piece, without a copy; nothing where there is none."""
        for offset, data in self._pieces:
            if offset <= self._at < offset + len(data):
                found = data[self._at - offset :][: length if length >= 0 else None]
                self._at += len(found)
                return found
        return memoryview(b"")

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def close(self) -> None:
        self.closed = True


@dataclass(frozen=True, eq=False)
class GroupFile:
    """The row groups of one file; `sums` verify them, `None` where others wrote it."""

    path: Path
    footer: Footer
    sums: GroupEntries | None

    def log_ns(self, group: int) -> Int64:
        """`log_ns` of all rows where it isn't null. Raises DamageError where the column is damaged. Raises LogError
        where it is too large.
        """
        with open_regular(self.path) as file:
            chunk = next((c for c in self.footer.chunks(group) if c.column == _INDEX), None)
            if chunk is None:
                raise LogError(f"{self.path}: damaged footer, row group {group} has no {_INDEX}", "PQ001")
            if chunk.length > MAX_DECODED:
                raise LimitError(f"{self.path}: row group {group} has too many rows", "LIM004")
            data = _read(file, chunk.offset, chunk.length)
        if self.sums is not None and crc32(data) != self.sums.index_crc32[group]:
            raise DamageError("checksum of its log_ns doesn't match")
        source = _Pieces([(chunk.offset, data)], self.footer.size)
        self._size(source, chunk)
        log_ns = self._table(source, group, [_INDEX]).column(_INDEX).drop_null().to_numpy()
        # What doesn't fit an int64 is refused where the message is read.
        return np.asarray(np.minimum(log_ns, MAX_STAMP_NS) if log_ns.dtype == np.uint64 else log_ns, np.int64)

    def tables(self, group: int) -> Iterator[pa.Table]:
        """All rows, in one table, or where they are too large in several, which then are in the order of `log_ns`.
        Raises DamageError where a checksum doesn't match, or these aren't the rows that the footer promises. Raises
        LogError where the rows can't be read within bounded memory.
        """
        with open_regular(self.path) as file:
            chunks = self.footer.chunks(group)
            source: Any = file
            if self.sums is not None:
                source = self._verify(file, self.sums, group)
            elif sum(chunk.length for chunk in chunks) <= MAX_DECODED:
                pieces = [(chunk.offset, _read(file, chunk.offset, chunk.length)) for chunk in chunks]
                source = _Pieces(pieces, self.footer.size)
            size = sum(self._size(source, chunk) for chunk in chunks)
            names = list(self.footer.columns)
            if size <= MAX_DECODED:
                yield self._table(source, group, names)
                return
            where = f"{self.path}: row group {group} takes more than {MAX_DECODED} bytes"
            if any(column.content.is_nested for column in self.footer.columns.values()):
                raise LimitError(f"{where}; write smaller row groups", "LIM004")
            if (np.diff(self.log_ns(group)) < 0).any():
                advice = "sort it or write smaller row groups"
                raise LimitError(f"{where} and isn't in the order of log_ns; {advice}", "LIM004")
            yield from self._parts(source, group, names, size)

    def _verify(self, file: BinaryIO, sums: GroupEntries, group: int) -> _Pieces:
        """Read a row group at once and check its checksum."""
        offset, length = sums.offset[group], sums.length[group]
        if length > MAX_DECODED:
            raise LimitError(f"{self.path}: row group {group} has {length} bytes, the limit is {MAX_DECODED}", "LIM004")
        data = _read(file, offset, length)
        if crc32(data) != sums.crc32[group]:
            raise DamageError("checksum doesn't match")
        return _Pieces([(offset, data)], self.footer.size)

    def _size(self, source: Any, chunk: Chunk) -> int:
        """Bound for the memory that a column chunk takes when it is read [byte]. Raises DamageError where its bytes
        aren't pages. Raises LogError where one page would take more than `MAX_DECODED`, or its encoding has no bound.
        """
        where = f"{self.path}: column '{chunk.column}'"
        at = total = largest = dictionary = 0
        while at < chunk.length:
            source.seek(chunk.offset + at)
            page = read_page(memoryview(source.read(min(_HEADER, chunk.length - at))))
            if page.encoding in _GROWING:
                name = _GROWING[page.encoding]
                raise LogError(
                    f"{where}: encoding {name} can't be bounded in memory; write the column as PLAIN", "PQ001"
                )
            is_coded = page.encoding in _DICTIONARY_CODES and not page.is_dictionary
            size = page.num_values * _PER_VALUE + (0 if is_coded else page.unpacked)
            if size + page.unpacked > MAX_DECODED:
                taken = f"a page takes {size + page.unpacked} bytes, the limit is {MAX_DECODED}"
                raise LimitError(f"{where}: {taken}; write smaller row groups", "LIM004")
            total += size + (page.num_values * dictionary if is_coded and chunk.is_bytes else 0)
            largest = max(largest, page.unpacked)
            if page.is_dictionary:
                dictionary = page.unpacked
            at += page.header + page.stored
        return total + largest

    def _table(self, source: Any, group: int, names: list[str]) -> pa.Table:
        try:
            table = self._open(source, 0).read_row_group(group, columns=names, use_threads=False)
        except (OSError, ValueError, pa.ArrowException) as error:
            raise DamageError(reason_of(error)) from error
        if table.num_rows != self.footer.groups[group].num_rows:
            raise DamageError(f"{table.num_rows} rows instead of {self.footer.groups[group].num_rows}")
        return table

    def _parts(self, source: Any, group: int, names: list[str], size: int) -> Iterator[pa.Table]:
        num_rows = self.footer.groups[group].num_rows
        length = max(1, num_rows * _PART // size)
        try:
            reader = self._open(source, 1024 * 1024)
            for batch in reader.iter_batches(length, [group], names, use_threads=False):
                num_rows -= batch.num_rows
                yield pa.Table.from_batches([batch])
        except (OSError, ValueError, pa.ArrowException) as error:
            raise DamageError(reason_of(error)) from error
        if num_rows:
            raise DamageError(f"{num_rows} rows are missing")

    def _open(self, source: Any, buffer_size: int) -> pq.ParquetFile:
        # Row groups with a checksum of their own needn't be checked page by page.
        return pq.ParquetFile(
            pa.PythonFile(source, mode="r"), metadata=self.footer.metadata, pre_buffer=False, buffer_size=buffer_size,
            page_checksum_verification=self.sums is None,
        )  # fmt: skip


def _read(file: BinaryIO, offset: int, length: int) -> memoryview:
    """Read bytes that are all there. Raises DamageError where the file has fewer."""
    size = os.fstat(file.fileno()).st_size
    data = os.pread(file.fileno(), length, offset) if offset + length <= size else b""
    if len(data) != length:
        raise DamageError(f"{len(data)} bytes instead of {length}")
    return memoryview(data)
