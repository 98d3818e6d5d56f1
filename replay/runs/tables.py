"""Boxes and timings as Parquet tables of a run folder; equal rows give equal bytes."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fbench.replay.contracts.errors import RunError
from fbench.replay.data.arrays import Array, Int64
from fbench.replay.data.boxes import Boxes, Boxes2D, Boxes3D
from fbench.replay.runs.columns import column_array, number_column, row_column, text_column

_ROWS_PER_GROUP = 4096
_JOINED_FRAMES = 64
_TYPES = {
    "center_m": pa.list_(pa.float64(), 3), "size_lwh_m": pa.list_(pa.float64(), 3), "yaw_rad": pa.float64(),
    "roll_rad": pa.float64(), "pitch_rad": pa.float64(), "velocity_mps": pa.list_(pa.float64(), 3),
    "camera": pa.string(), "xyxy_px": pa.list_(pa.float64(), 4), "visible_xyxy_px": pa.list_(pa.float64(), 4),
    "distance_m": pa.float64(), "range_rate_mps": pa.float64(), "label": pa.string(), "score": pa.float64(),
    "track_id": pa.int64(), "sources": pa.uint8(), "predicted": pa.bool_(), "visibility": pa.float64(),
    "occlusion": pa.float64(), "truncation": pa.float64(), "attribute": pa.string(), "num_lidar_pts": pa.int64(),
    "num_radar_pts": pa.int64(), "ignore": pa.bool_(), "source_label": pa.string(),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class BoxTable:
    """The boxes of all frames of a run, in the order of the frames."""

    frames: Int64  # (N,) index of the frame of each box, ascending
    boxes: Boxes

    def at(self, index: int) -> Boxes:
        """Boxes of one frame."""
        start, stop = np.searchsorted(self.frames, [index, index + 1])
        return self.boxes[int(start) : int(stop)]


class BoxWriter:
    """Writes boxes of one type frame by frame, with bounded memory."""

    def __init__(self, path: Path, kind: type[Boxes2D] | type[Boxes3D]) -> None:
        self._schema = box_schema(kind)
        self._file = pa.OSFile(os.fsencode(path), "wb")
        self._writer = pq.ParquetWriter(self._file, self._schema, compression="zstd", write_page_checksum=True)
        self._joined: list[pa.RecordBatch] = []
        self._pending: list[pa.RecordBatch] = []
        self._num_rows = 0
        self._present: dict[str, None] = {}

    def add(self, frame: int, boxes: Boxes) -> None:
        """Append the boxes of frame `frame`; frames without boxes cost nothing."""
        arrays = boxes.arrays()
        self._present.update(dict.fromkeys(arrays))
        if not len(boxes):
            return
        columns = [number_column(np.full(len(boxes), frame), pa.int64())]
        columns += [_column(arrays.get(f.name), f.type, len(boxes)) for f in list(self._schema)[1:]]
        self._pending.append(pa.RecordBatch.from_arrays(columns, schema=self._schema))
        self._num_rows += len(boxes)
        if len(self._pending) == _JOINED_FRAMES:
            self._join()
        if self._num_rows >= _ROWS_PER_GROUP:
            self._flush()

    def close(self) -> None:
        """Write what is pending and finish the file."""
        self._flush()
        self._writer.add_key_value_metadata({"present": ",".join(sorted(self._present))})
        self._writer.close()
        self._file.close()

    def _join(self) -> None:
        """Copy many small batches into one: each costs kilobytes beside its rows."""
        if self._pending:
            self._joined += pa.Table.from_batches(self._pending).combine_chunks().to_batches()
        self._pending = []

    def _flush(self) -> None:
        self._join()
        if self._num_rows:
            self._writer.write_table(pa.Table.from_batches(self._joined).combine_chunks())
        self._joined, self._num_rows = [], 0


def box_schema(kind: type[Boxes2D] | type[Boxes3D]) -> pa.Schema:
    """Names and types of the columns of a table of boxes."""
    names = [f.name for f in fields(kind)]
    return pa.schema([("frame", pa.int64()), *((n, _TYPES[n]) for n in names)], {"boxes": kind.__name__})


def _column(array: Array | None, kind: pa.DataType, length: int) -> pa.Array:
    if array is None:
        return pa.nulls(length, kind)
    if array.ndim == 2:
        return row_column(array)
    return text_column(array.tolist()) if array.dtype.kind == "U" else number_column(array, kind)


def read_boxes(path: Path) -> BoxTable:
    """Read what `BoxWriter` wrote; fields that no frame had are `None`, single nulls become NaN, -1 or empty. Raises
    RunError where the file is missing or isn't a table of boxes.
    """
    table = read_table(path)
    kind = {b"Boxes2D": Boxes2D, b"Boxes3D": Boxes3D}.get((table.schema.metadata or {}).get(b"boxes", b""))
    if kind is None or not table.schema.equals(box_schema(kind)):
        raise RunError(f"{path}: can't be read (not a table of boxes)")
    # The names are kept apart, since a table without rows can't show which fields its boxes had.
    present = (pq.read_metadata(pa.OSFile(os.fsencode(path))).metadata or {}).get(b"present", b"").decode().split(",")
    arrays = {f.name: column_array(table.column(f.name)) for f in fields(kind) if f.name in present}
    frames = column_array(table.column("frame"))
    boxes = replace(Boxes2D.empty(), **arrays) if kind is Boxes2D else replace(Boxes3D.empty(), **arrays)
    order = np.argsort(frames, kind="stable")
    return BoxTable(frames[order], boxes[order])


def read_table(path: Path, columns: list[str] | None = None) -> pa.Table:
    """Read a Parquet file, or some of its columns, checksums verified. Raises RunError where it can't be read."""
    try:
        with (
            pa.OSFile(os.fsencode(path)) as file,  # whose name needn't be Unicode
            pq.ParquetFile(file, page_checksum_verification=True, pre_buffer=False) as table,
        ):
            return table.read(columns, use_threads=False)  # `pq.read_table` imports pandas
    except (OSError, pa.ArrowException) as error:
        raise RunError(f"{path}: can't be read ({str(error).splitlines()[0]})") from error


def write_table(path: Path, columns: Mapping[str, pa.Array]) -> None:
    """Write one Parquet file with checksums."""
    with pa.OSFile(os.fsencode(path), "wb") as file:
        pq.write_table(pa.table(dict(columns)), file, compression="zstd", write_page_checksum=True)
