"""Writing the file of one stream: rows are gathered to row groups, their checksums taken while they are written."""

import os
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa
import pyarrow.parquet as pq

from fbench.replay.checksums import crc32
from fbench.replay.errors import LogError
from fbench.replay.logs.parquet.columns import StreamKind, arrow_schema
from fbench.replay.logs.parquet.encode import Encoded
from fbench.replay.logs.parquet.footer import MAX_ZEROS, ZEROS_PER_CHUNK
from fbench.replay.logs.parquet.log_json import Checksums, GroupEntries


class _Sink:
    """The file that pyarrow writes to, which counts and sums up all bytes."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.digest = blake2b(digest_size=16)
        self.size = self.crc32 = 0
        self.closed = self.is_abandoned = False

    def write(self, data: Any) -> int:
        with memoryview(data) as view:
            if self.is_abandoned:
                return view.nbytes
            self.digest.update(view)
            self.crc32 = crc32(view, self.crc32)
            self.size += view.nbytes
            self._file.write(view)
            return view.nbytes

    def take_crc32(self) -> int:
        """Checksum of what was written since the last call."""
        taken, self.crc32 = self.crc32, 0
        return taken

    def tell(self) -> int:
        return self.size

    def writable(self) -> bool:
        return True

    def flush(self) -> None:
        self._file.flush()

    def close(self) -> None:
        self.closed = True


class StreamWriter:
    """Gathers the rows of one stream and writes them a row group at a time.

    Raises:
        OSError, pa.ArrowException: where the file can't be written.
        LogError: where it would have more row groups than readers take.
    """

    def __init__(self, path: Path, kind: StreamKind, compression: str) -> None:
        self.pending_size = 0
        self._path = path
        self._rows: list[tuple[Any, ...]] = []
        self._schema = arrow_schema(kind)
        self._file = path.open("xb")
        self._sink = _Sink(self._file)
        self._writer = pq.ParquetWriter(
            pa.PythonFile(self._sink, mode="w"), self._schema, compression=compression, use_dictionary=False,
            write_statistics=False, write_page_checksum=True,
        )  # fmt: skip
        self._groups: list[tuple[int, int, int, int, int, int]] = []

    @property
    def num_pending(self) -> int:
        """Rows that aren't written yet."""
        return len(self._rows)

    def add(self, row: Encoded) -> None:
        """Take a row."""
        self._rows.append(row.values)
        self.pending_size += row.size

    def flush(self) -> None:
        """Write what was gathered as one row group."""
        if not self._rows:
            return
        if (len(self._groups) + 1) * len(self._schema) * ZEROS_PER_CHUNK > MAX_ZEROS:
            raise LogError(f"{self._path.name}: more row groups than can be read; write more rows a group")
        columns = [
            pa.array(values, f.type) for values, f in zip(zip(*self._rows, strict=True), self._schema, strict=True)
        ]
        log_ns = [row[0] for row in self._rows]
        offset = self._mark()
        self._writer.write_table(pa.table(columns, schema=self._schema), row_group_size=len(log_ns))
        length = self._sink.size - offset
        self._groups.append((offset, length, self._sink.take_crc32(), len(log_ns), min(log_ns), max(log_ns)))
        self._rows, self.pending_size = [], 0

    def close(self) -> tuple[Checksums, int]:
        """Finish the file; returns its checksums and the number of rows."""
        self.flush()
        self._mark()
        self._writer.close()
        self._file.flush()
        os.fsync(self._file.fileno())
        self.discard()
        groups = list(zip(*self._groups, strict=True)) or [()] * 6
        offset, length, sums32, num_rows, start, end = (list(column) for column in groups)
        entries = GroupEntries(
            offset=offset, length=length, crc32=sums32, index_crc32=_index_sums(self._path), num_rows=num_rows,
            min_log_ns=start, max_log_ns=end,
        )  # fmt: skip
        sums = Checksums(
            size=self._sink.size, blake2b=self._sink.digest.hexdigest(), footer_crc32=self._sink.crc32,
            row_groups=entries,
        )  # fmt: skip
        return sums, sum(num_rows)

    def discard(self) -> None:
        """Close the file as it is; pyarrow, which would go on writing when it is deleted, finds no file any more."""
        self._sink.is_abandoned = True
        self._writer.close()
        with suppress(OSError):  # on a full disk, what is still buffered has no place
            self._file.close()

    def _mark(self) -> int:
        """Begin a new checksum; returns where that is."""
        self._sink.take_crc32()
        return self._sink.size


def _index_sums(path: Path) -> list[int]:
    """Checksums of the first column of all row groups, whose end only the footer tells."""
    metadata = pq.read_metadata(path)
    sums = []
    with path.open("rb") as file:
        for group in range(metadata.num_row_groups):
            column = metadata.row_group(group).column(0)
            file.seek(column.data_page_offset)
            sums.append(crc32(file.read(column.total_compressed_size)))
    return sums
