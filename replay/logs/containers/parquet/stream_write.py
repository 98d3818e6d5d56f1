"""Writing of one stream: messages as rows, rows gathered to row groups with checksums."""

import os
from collections.abc import Iterable
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fbench.replay.contracts.errors import DataError, LogError
from fbench.replay.data.arrays import Array
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan
from fbench.replay.logs.codecs.codec import TruthPart
from fbench.replay.logs.container import Entry
from fbench.replay.logs.containers.limits import crc32
from fbench.replay.logs.containers.parquet.columns import COLUMNS, StreamKind, arrow_schema
from fbench.replay.logs.containers.parquet.footer import MAX_ZEROS, ZEROS_PER_CHUNK
from fbench.replay.logs.containers.parquet.log_json import Checksums, GroupEntries

_OVERHEAD = 400  # What a row costs beside its large values [byte]: so that many small ones count too


class Encoded(NamedTuple):
    """One row."""

    values: tuple[Any, ...]
    size: int  # About how much memory it holds [byte]


def message_kind(message: Message) -> StreamKind:
    """Return the kind of stream that holds such messages."""
    match message:
        case Image():
            return "camera"
        case PointCloud():
            return "lidar"
        case RadarScan():
            return "radar"
        case Pose():
            return "pose"


def message_row(message: Message, position: int) -> Encoded:
    """Encode a message. Raises ValueError where a text isn't Unicode."""
    head = (message.log_ns, message.stamp_ns, message.frame_number, position)
    return _encode((*head, *_payload(message)))


def _payload(message: Message) -> tuple[Any, ...]:
    match message:
        case Image():
            return (_text(message.encoding), *_size_wh(message), bytes(message.data))
        case PointCloud(xyz=xyz):
            arrays = (_pack(message.intensity, "<f4"), _pack(message.ring, "<u2"))
            return (len(xyz), _pack(xyz, "<f4"), *arrays, _pack(message.offset_ns, "<i4"))
        case RadarScan(xyz=xyz):
            more = (
                message.radial_velocity_mps, message.rcs_dbsm, message.range_m, message.azimuth_rad,
                message.altitude_rad,
            )  # fmt: skip
            return (len(xyz), *(_pack(array, "<f4") for array in (xyz, *more)))
        case Pose():
            return (message.translation_m.tolist(), message.rotation_xyzw.tolist())


def _size_wh(image: Image) -> tuple[int, int]:
    if not all(0 <= size < 2**63 for size in image.size_wh):
        raise ValueError(f"size {image.size_wh}")
    return image.size_wh


def part_kind(part: TruthPart) -> StreamKind:
    """Return the kind of stream that holds such truth."""
    return "truth_2d" if part.is_2d else "truth_3d"


def part_row(part: TruthPart, position: int) -> Encoded:
    """Encode truth. Raises ValueError where a text isn't Unicode."""
    truth = part.truth
    head = (truth.log_ns, truth.stamp_ns, truth.frame_number, position, part.expects_2d, _text(part.frame_id) or None)
    boxes = truth.boxes2d if part.is_2d else truth.boxes3d
    names = list(COLUMNS[part_kind(part)])[len(head) :]
    return _encode((*head, *_boxes(boxes, names)))


def _boxes(boxes: Boxes2D | Boxes3D | None, names: Iterable[str]) -> Iterable[Any]:
    arrays = {} if boxes is None else boxes.arrays()
    for name in names:
        values = arrays[name].tolist() if name in arrays else None
        for text in values or ():
            if isinstance(text, str):
                _text(text)
        yield values


def raw_row(entry: Entry, position: int) -> Encoded:
    """Encode a message of another program, as it is. Raises DataError where the entry holds a decoded message."""
    if not isinstance(entry.data, memoryview):
        raise DataError("holds no bytes of another program")
    return _encode((entry.log_ns, entry.publish_ns, entry.sequence, position, bytes(entry.data)))


def _pack(array: Array | None, dtype: str) -> bytes | None:
    return None if array is None else np.ascontiguousarray(array, dtype).tobytes()


def _text(text: str) -> str:
    text.encode()
    return text


def _encode(values: tuple[Any, ...]) -> Encoded:
    return Encoded(values, _OVERHEAD + sum(_size(value) for value in values))


def _size(value: object) -> int:
    if isinstance(value, bytes):
        return len(value)
    return sum(80 if isinstance(item, list) else 32 for item in value) if isinstance(value, list) else 0


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
