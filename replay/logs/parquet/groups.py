"""Reading one row group: bytes are verified and their claims bounded before pyarrow sees them."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fbench.replay.arrays import Int64
from fbench.replay.checksums import crc32
from fbench.replay.errors import LimitError, LogError
from fbench.replay.logs.parquet.footer import Chunk, Footer, reason_of
from fbench.replay.logs.parquet.log_json import GroupEntries
from fbench.replay.logs.parquet.pages import MAX_DECODED, decoded_size
from fbench.replay.logs.parquet.source import Piece, Pieces, opened
from fbench.replay.logs.parquet.thrift import DamageError

_HEADER = 64 * 1024
_PART = MAX_DECODED // 4
_INDEX = "log_ns"
_MAX_STAMP_NS = 2**63 - 1


@dataclass(frozen=True, eq=False)
class GroupFile:
    """The row groups of one file; `sums` verify them, `None` where others wrote it."""

    path: Path
    footer: Footer
    sums: GroupEntries | None

    def log_ns(self, group: int) -> Int64:
        """`log_ns` of all rows where it isn't null.

        Raises:
            DamageError: where the column is damaged.
            LogError: where it is too large.
        """
        with opened(self.path) as file:
            return self._log_ns(file, group)

    def tables(self, group: int) -> Iterator[pa.Table]:
        """All rows, in one table, or where they are too large in several, which then are in the order of `log_ns`.

        Raises:
            DamageError: where a checksum doesn't match, or these aren't the rows that the footer promises.
            LogError: where the rows can't be read within bounded memory.
        """
        with opened(self.path) as file:
            chunks = self.footer.chunks(group)
            stored = sum(chunk.length for chunk in chunks)
            if self.sums is not None:
                source: Any = self._verified(file, self.sums, group)
            elif stored <= MAX_DECODED:
                source = self._pieces([_read(file, chunk.offset, chunk.length) for chunk in chunks])
            else:
                source = file
            size = sum(self._size(file, source, chunk) for chunk in chunks)
            names = list(self.footer.columns)
            if size <= MAX_DECODED:
                yield self._table(source, group, names)
            else:
                self._require_order(file, group)
                yield from self._parts(source, group, names, size)

    def _log_ns(self, file: BinaryIO, group: int) -> Int64:
        chunk = next((c for c in self.footer.chunks(group) if c.column == _INDEX), None)
        if chunk is None:
            raise LogError(f"{self.path}: damaged footer, row group {group} has no {_INDEX}", "PQ001")
        if chunk.length > MAX_DECODED:
            raise LimitError(f"{self.path}: row group {group} has too many rows", "LIM004")
        piece = _read(file, chunk.offset, chunk.length)
        if self.sums is not None and crc32(piece.data) != self.sums.index_crc32[group]:
            raise DamageError("checksum of its log_ns doesn't match")
        source = self._pieces([piece])
        self._size(file, source, chunk)
        column = self._table(source, group, [_INDEX]).column(_INDEX)
        log_ns = column.drop_null().to_numpy()
        # What doesn't fit an int64 is refused where the message is read.
        return np.asarray(np.minimum(log_ns, _MAX_STAMP_NS) if log_ns.dtype == np.uint64 else log_ns, np.int64)

    def _verified(self, file: BinaryIO, sums: GroupEntries, group: int) -> Pieces:
        """Read a row group at once and check its checksum."""
        offset, length = sums.offset[group], sums.length[group]
        if length > MAX_DECODED:
            raise LimitError(f"{self.path}: row group {group} has {length} bytes, the limit is {MAX_DECODED}", "LIM004")
        piece = _read(file, offset, length)
        if crc32(piece.data) != sums.crc32[group]:
            raise DamageError("checksum doesn't match")
        return self._pieces([piece])

    def _pieces(self, pieces: list[Piece]) -> Pieces:
        return Pieces(pieces, self.footer.size)

    def _size(self, file: BinaryIO, source: Any, chunk: Chunk) -> int:
        def fetch(at: int) -> memoryview:
            length = min(_HEADER, chunk.length - at)
            if isinstance(source, Pieces):
                source.seek(chunk.offset + at)
                return source.read(length)
            return memoryview(os.pread(file.fileno(), length, chunk.offset + at))

        return decoded_size(f"{self.path}: column '{chunk.column}'", fetch, chunk.length, chunk.is_bytes)

    def _table(self, source: Any, group: int, names: list[str]) -> pa.Table:
        try:
            table = self._opened(source, 0).read_row_group(group, columns=names, use_threads=False)
        except (OSError, ValueError, pa.ArrowException) as error:
            raise DamageError(reason_of(error)) from error
        if table.num_rows != self.footer.groups[group].num_rows:
            raise DamageError(f"{table.num_rows} rows instead of {self.footer.groups[group].num_rows}")
        return table

    def _parts(self, source: Any, group: int, names: list[str], size: int) -> Iterator[pa.Table]:
        num_rows = self.footer.groups[group].num_rows
        length = max(1, num_rows * _PART // size)
        try:
            reader = self._opened(source, 1024 * 1024)
            for batch in reader.iter_batches(length, [group], names, use_threads=False):
                num_rows -= batch.num_rows
                yield pa.Table.from_batches([batch])
        except (OSError, ValueError, pa.ArrowException) as error:
            raise DamageError(reason_of(error)) from error
        if num_rows:
            raise DamageError(f"{num_rows} rows are missing")

    def _opened(self, source: Any, buffer_size: int) -> pq.ParquetFile:
        # Row groups with a checksum of their own needn't be checked page by page.
        return pq.ParquetFile(
            pa.PythonFile(source, mode="r"), metadata=self.footer.metadata, pre_buffer=False, buffer_size=buffer_size,
            page_checksum_verification=self.sums is None,
        )  # fmt: skip

    def _require_order(self, file: BinaryIO, group: int) -> None:
        where = f"{self.path}: row group {group} takes more than {MAX_DECODED} bytes"
        if any(column.content.nested for column in self.footer.columns.values()):
            raise LimitError(f"{where}; write smaller row groups", "LIM004")
        if (np.diff(self._log_ns(file, group)) < 0).any():
            raise LimitError(f"{where} and isn't in the order of log_ns; sort it or write smaller row groups", "LIM004")


def _read(file: BinaryIO, offset: int, length: int) -> Piece:
    """Read bytes that are all there.

    Raises:
        DamageError: where the file has fewer.
    """
    size = os.fstat(file.fileno()).st_size
    data = os.pread(file.fileno(), length, offset) if offset + length <= size else b""
    if len(data) != length:
        raise DamageError(f"{len(data)} bytes instead of {length}")
    return Piece(offset, memoryview(data))
