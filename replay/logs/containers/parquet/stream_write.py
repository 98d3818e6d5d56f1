"""Writing of one stream: messages as rows, rows gathered to row groups with checksums."""

import os
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fbench.replay.contracts.errors import DataError, LogError
from fbench.replay.data.arrays import Array
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan
from fbench.replay.logs.codecs.codec import TruthPart
from fbench.replay.logs.container import Entry
from fbench.replay.logs.containers.limits import crc32
from fbench.replay.logs.containers.parquet.columns import COLUMNS, StreamKind, arrow_schema
from fbench.replay.logs.containers.parquet.footer import MAX_ZEROS, ZEROS_PER_CHUNK
from fbench.replay.logs.containers.parquet.log_json import Checksums, GroupEntries, StreamEntry

_OVERHEAD = 400  # What a row costs beside its large values [byte]: so that many small ones count too
RowValues = tuple[Any, ...]
"""One row: a value a column, in the order of `COLUMNS`."""


def message_row(message: Message, position: int) -> RowValues:
    """Encode a message. Raises ValueError where a text isn't Unicode."""
    head = (message.log_ns, message.stamp_ns, message.frame_number, position)
    match message:
        case Image():
            encoding = _text(message.encoding)
            if not all(0 <= size < 2**63 for size in message.size_wh):
                raise ValueError(f"size {message.size_wh}")
            return (*head, encoding, *message.size_wh, bytes(message.data))
        case PointCloud(xyz=xyz, intensity=intensity, ring=ring, offset_ns=offset_ns):
            arrays = (_pack(xyz), _pack(intensity), _pack(ring, "<u2"), _pack(offset_ns, "<i4"))
            return (*head, len(xyz), *arrays)
        case RadarScan(xyz=xyz):
            velocity, polar = message.radial_velocity_mps, (message.range_m, message.azimuth_rad, message.altitude_rad)
            return (*head, len(xyz), *map(_pack, (xyz, velocity, message.rcs_dbsm, *polar)))
        case Pose():
            return (*head, message.translation_m.tolist(), message.rotation_xyzw.tolist())


def part_kind(part: TruthPart) -> StreamKind:
    """Return the kind of stream that holds such truth."""
    return "truth_2d" if part.is_2d else "truth_3d"


def part_row(part: TruthPart, position: int) -> RowValues:
    """Encode truth. Raises ValueError where a text isn't Unicode."""
    truth = part.truth
    head = (truth.log_ns, truth.stamp_ns, truth.frame_number, position, part.expects_2d, _text(part.frame_id) or None)
    boxes = truth.boxes2d if part.is_2d else truth.boxes3d
    arrays = {} if boxes is None else boxes.arrays()
    names = list(COLUMNS[part_kind(part)])[len(head) :]
    columns = [arrays[name].tolist() if name in arrays else None for name in names]
    for text in (value for values in columns for value in values or () if isinstance(value, str)):
        _text(text)
    return (*head, *columns)


def raw_row(entry: Entry, position: int) -> RowValues:
    """Encode a message of another program, as it is. Raises DataError where the entry holds a decoded message."""
    if not isinstance(entry.data, memoryview):
        raise DataError("holds no bytes of another program")
    return (entry.log_ns, entry.publish_ns, entry.sequence, position, bytes(entry.data))


def row_size(row: RowValues) -> int:
    """About how much memory a row holds [byte]."""
    lists = sum(80 if isinstance(item, list) else 32 for value in row if isinstance(value, list) for item in value)
    return _OVERHEAD + lists + sum(len(value) for value in row if isinstance(value, bytes))


def _pack(array: Array | None, dtype: str = "<f4") -> bytes | None:
    return None if array is None else np.ascontiguousarray(array, dtype).tobytes()


def _text(text: str) -> str:
    text.encode()
    return text


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

    def tell(self) -> int:
        return self.size

    def writable(self) -> bool:
        return True

    def flush(self) -> None:
        self._file.flush()

    def close(self) -> None:
        self.closed = True


class StreamWriter:
    """Gathers the rows of one stream and writes them a row group at a time. Raises OSError or pa.ArrowException where
    the file can't be written. Raises LogError where it would have more row groups than readers take.
    """

    def __init__(self, folder: Path, entry: StreamEntry, compression: str) -> None:
        self.pending_size = 0  # What the rows that aren't written yet hold [byte]
        self._path, self._entry = folder / entry.file, entry
        self._rows: list[RowValues] = []
        self._schema = arrow_schema(entry.kind)
        self._file = self._path.open("xb")
        self._sink = _Sink(self._file)
        self._writer = pq.ParquetWriter(
            pa.PythonFile(self._sink, mode="w"), self._schema, compression=compression, use_dictionary=False,
            write_statistics=False, write_page_checksum=True,
        )  # fmt: skip
        names = ("offset", "length", "crc32", "num_rows", "min_log_ns", "max_log_ns")
        self._groups: dict[str, list[int]] = {name: [] for name in names}

    @property
    def num_pending(self) -> int:
        """Rows that aren't written yet."""
        return len(self._rows)

    def add(self, row: RowValues, size: int) -> None:
        """Take a row."""
        self._rows.append(row)
        self.pending_size += size

    def flush(self) -> None:
        """Write what was gathered as one row group."""
        if not self._rows:
            return
        if (len(self._groups["offset"]) + 1) * len(self._schema) * ZEROS_PER_CHUNK > MAX_ZEROS:
            raise LogError(f"{self._path.name}: more row groups than can be read; write more rows a group")
        columns = zip(zip(*self._rows, strict=True), self._schema, strict=True)
        table = pa.table([pa.array(values, field.type) for values, field in columns], schema=self._schema)
        log_ns = [row[0] for row in self._rows]
        offset, self._sink.crc32 = self._sink.size, 0
        self._writer.write_table(table, row_group_size=len(log_ns))
        sums = (offset, self._sink.size - offset, self._sink.crc32, len(log_ns), min(log_ns), max(log_ns))
        for column, value in zip(self._groups.values(), sums, strict=True):
            column.append(value)
        self._rows, self.pending_size = [], 0

    def close(self) -> StreamEntry:
        """Finish the file; returns its entry with checksums, number of rows and times."""
        self.flush()
        self._sink.crc32 = 0  # From here on, it is that of the footer
        self._writer.close()
        self._file.flush()
        os.fsync(self._file.fileno())
        self.discard()
        groups = GroupEntries(**self._groups, index_crc32=self._index_sums())
        sums = Checksums(
            size=self._sink.size, blake2b=self._sink.digest.hexdigest(), footer_crc32=self._sink.crc32,
            row_groups=groups,
        )  # fmt: skip
        ends = {"first_log_ns": min(groups.min_log_ns), "last_log_ns": max(groups.max_log_ns)}
        return self._entry.model_copy(update={"num_rows": sum(groups.num_rows), "checksums": sums, **ends})

    def discard(self) -> None:
        """Close the file as it is; pyarrow, which would go on writing when it is deleted, finds no file any more."""
        self._sink.is_abandoned = True
        self._writer.close()
        with suppress(OSError):  # on a full disk, what is still buffered has no place
            self._file.close()

    def _index_sums(self) -> list[int]:
        """Checksums of the first column of all row groups, whose end only the footer tells."""
        metadata = pq.read_metadata(pa.OSFile(os.fsencode(self._path)))
        sums = []
        with self._path.open("rb") as file:
            for group in range(metadata.num_row_groups):
                column = metadata.row_group(group).column(0)
                file.seek(column.data_page_offset)
                sums.append(crc32(file.read(column.total_compressed_size)))
        return sums
