"""Rows of a decoded row group, and the messages that they hold; large values are views."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from fbench.replay.contracts.errors import DataError, DecodeError
from fbench.replay.data.arrays import Array, Bool, text_array
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan, Truth
from fbench.replay.logs.codecs.codec import TruthPart
from fbench.replay.logs.containers.parquet.columns import BOXES_NEEDED, Column, Content, StreamKind

_MAX_FRAME_NUMBER = 2**32 - 1
_DTYPES = {
    Content.INTS: "i8", Content.SMALL: "u1", Content.FLAGS: "?", Content.FLOATS: "f8", Content.VEC3: "f8",
    Content.VEC4: "f8", Content.VECS3: "f8", Content.VECS4: "f8",
}  # fmt: skip
_WIDTHS = {Content.VECS3: 3, Content.VECS4: 4}


class Numbers(NamedTuple):
    """A column of integers."""

    values: Array
    valid: Bool

    def get(self, row: int) -> int | None:
        """Value of a row, `None` where it is null."""
        return int(self.values[row]) if self.valid[row] else None


class Blobs(NamedTuple):
    """A column of binary values."""

    offsets: Array
    data: memoryview
    valid: Bool

    def get(self, row: int) -> memoryview | None:
        """Value of a row as a view, `None` where it is null."""
        return self.data[self.offsets[row] : self.offsets[row + 1]] if self.valid[row] else None


class Rows:
    """The columns of a row group by name.

    Raises:
        ValueError, pa.ArrowException: where a value doesn't fit the documented type.
    """

    def __init__(self, table: pa.Table, columns: Mapping[str, Column]) -> None:
        self.num = int(table.num_rows)
        self.numbers: dict[str, Numbers] = {}
        self._blobs: dict[str, Blobs] = {}
        self._others: dict[str, tuple[pa.Array, Content]] = {}
        for name, column in columns.items():
            array = _whole(table.column(name))
            if column.content in (Content.INT, Content.UINT):
                self.numbers[name] = _numbers(_cast(array, column.content.value))
            elif column.content is Content.BYTES:
                self._blobs[name] = _blobs(array)
            else:
                self._others[name] = (array, column.content)

    def number(self, name: str, row: int) -> int:
        """Return an integer. Raises DecodeError where it is null."""
        value = self.optional(name, row)
        if value is None:
            raise DecodeError(f"{name} is null")
        return value

    def optional(self, name: str, row: int) -> int | None:
        """Return an integer; `None` where it is null or the column isn't there."""
        column = self.numbers.get(name)
        return None if column is None else column.get(row)

    def blob(self, name: str, row: int) -> memoryview:
        """Return binary data. Raises DecodeError where it is null."""
        value = self.nullable(name, row)
        if value is None:
            raise DecodeError(f"{name} is null")
        return value

    def nullable(self, name: str, row: int) -> memoryview | None:
        """Return binary data; `None` where it is null."""
        return self._blobs[name].get(row)

    def packed(self, name: str, row: int, dtype: str) -> Array | None:
        """Return the numbers that are packed into binary data, as a view; `None` where there are none."""
        column = self._blobs.get(name)
        data = None if column is None else column.get(row)
        if data is None:
            return None
        if len(data) % np.dtype(dtype).itemsize:
            raise DecodeError(f"{name} has {len(data)} bytes, which aren't whole numbers of type {dtype}")
        array = np.frombuffer(data, dtype)
        return array if array.flags.aligned else array.copy()

    def value(self, name: str, row: int) -> Any:
        """Return a text, flag or list; `None` where it is null or the column isn't there. Raises DecodeError where it
        isn't Unicode, has nulls inside, or vectors of another width.
        """
        if name not in self._others:
            return None
        array, content = self._others[name]
        scalar = array[row]
        try:
            if not content.nested:
                return scalar.as_py()
            return _list(scalar, content) if scalar.is_valid else None
        except (ValueError, pa.ArrowException) as error:
            raise DecodeError(f"{name}: {error}") from error


def _whole(column: pa.ChunkedArray) -> pa.Array:
    if column.num_chunks == 1:
        return column.chunk(0)
    return pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], column.type)


def _cast(array: pa.Array, kind: pa.DataType) -> pa.Array:
    return array if array.type == kind else array.cast(kind)


def _valid(array: pa.Array) -> Bool:
    if array.null_count == 0:
        return np.ones(len(array), bool)
    return np.asarray(array.is_valid().to_numpy(zero_copy_only=False))


def _numbers(array: pa.Array) -> Numbers:
    if array.null_count:
        return Numbers(array.fill_null(0).to_numpy(), _valid(array))
    return Numbers(array.to_numpy(), _valid(array))


def _blobs(array: pa.Array) -> Blobs:
    _, offsets, data = array.buffers()
    if len(array) == 0 or offsets is None:
        return Blobs(np.zeros(1, np.int64), memoryview(b""), _valid(array))
    dtype = np.dtype(np.int64 if pa.types.is_large_binary(array.type) else np.int32)
    bounds = np.frombuffer(offsets, dtype, len(array) + 1, dtype.itemsize * array.offset)
    # Buffers of Arrow call their bytes signed.
    return Blobs(bounds, memoryview(b"" if data is None else data).cast("B"), _valid(array))


def _list(scalar: Any, content: Content) -> Array:
    """Values of a list as an array (N,) or (N, width)."""
    values = scalar.values
    if content is Content.TEXTS:
        texts = values.to_pylist()
        if None in texts:
            raise ValueError("null in a list")
        return text_array(texts)
    num, width = len(values), _WIDTHS.get(content)
    if width is not None:
        inner = values.flatten()
        if values.null_count or set(values.value_lengths().to_pylist()) - {width}:
            raise ValueError(f"vectors that don't have {width} values")
        values = inner
    if values.null_count:
        raise ValueError("null in a list")
    dtype = np.dtype(_DTYPES[content])
    array = np.asarray(values.to_numpy(zero_copy_only=False)).astype(dtype, casting="same_kind", copy=False)
    return array if width is None else array.reshape(num, width)


class Row(NamedTuple):
    """One message; implements `fbench.replay.logs.container.Stored`."""

    rows: Rows
    row: int
    kind: StreamKind
    sensor: str

    def read(self) -> Message | TruthPart:
        """Decode the row. Raises DecodeError where its columns don't fit together."""
        try:
            return _READERS[self.kind](self)
        except DataError as error:
            raise DecodeError(str(error)) from error

    @property
    def log_ns(self) -> int:
        """When it was recorded."""
        return self.rows.number("log_ns", self.row)

    @property
    def stamp_ns(self) -> int:
        """When it was measured."""
        return self.rows.number("stamp_ns", self.row)

    @property
    def frame_number(self) -> int | None:
        """Number of its frame."""
        number = self.rows.optional("frame_number", self.row)
        if number is not None and not 0 <= number <= _MAX_FRAME_NUMBER:
            raise DecodeError(f"frame_number {number} is outside 0 to {_MAX_FRAME_NUMBER}")
        return number

    def points(self) -> Array:
        """Coordinates (N, 3), the number of which is checked."""
        xyz = self.rows.packed("xyz", self.row, "<f4")
        if xyz is None or len(xyz) % 3:
            raise DecodeError("xyz is null" if xyz is None else f"xyz has {len(xyz)} values, which aren't points")
        claimed = self.rows.optional("num_points", self.row)
        if claimed is not None and claimed * 3 != len(xyz):
            raise DecodeError(f"num_points is {claimed}, xyz has {len(xyz) // 3} points")
        return xyz.reshape(-1, 3)

    def column(self, name: str, dtype: str = "<f4") -> Array | None:
        """Return a column of the points."""
        return self.rows.packed(name, self.row, dtype)

    def require(self, name: str) -> Any:
        """Return a value that must be there."""
        value = self.rows.value(name, self.row)
        if value is None:
            raise DecodeError(f"{name} is null")
        return value


def _image(row: Row) -> Image:
    width, height = row.rows.number("width", row.row), row.rows.number("height", row.row)
    if min(width, height) < 0:
        raise DecodeError(f"image of {width}x{height}")
    data, encoding = bytes(row.rows.blob("data", row.row)), row.require("encoding")
    return Image(row.sensor, row.stamp_ns, row.log_ns, data, encoding, (width, height), row.frame_number)


def _cloud(row: Row) -> PointCloud:
    return PointCloud(
        row.sensor, row.stamp_ns, row.log_ns, row.points(), row.column("intensity"), row.column("ring", "<u2"),
        row.column("offset_ns", "<i4"), row.frame_number,
    )  # fmt: skip


def _scan(row: Row) -> RadarScan:
    return RadarScan(
        row.sensor, row.stamp_ns, row.log_ns, row.points(), row.column("radial_velocity_mps"), row.column("rcs_dbsm"),
        row.column("range_m"), row.column("azimuth_rad"), row.column("altitude_rad"), row.frame_number,
    )  # fmt: skip


def _pose(row: Row) -> Pose:
    translation_m, rotation_xyzw = row.require("translation_m"), row.require("rotation_xyzw")
    return Pose(row.sensor, row.stamp_ns, row.log_ns, translation_m, rotation_xyzw, row.frame_number)


def _part(row: Row) -> TruthPart:
    is_2d = row.kind == "truth_2d"
    frame_id, expects_2d = row.rows.value("frame_id", row.row) or "", bool(row.rows.value("expects_2d", row.row))
    boxes3d, boxes2d = (None, _boxes(row, Boxes2D)) if is_2d else (_boxes(row, Boxes3D), None)
    truth = Truth(row.stamp_ns, row.log_ns, boxes3d, boxes2d, row.frame_number)
    return TruthPart(truth, is_2d, expects_2d, frame_id)


def _boxes(row: Row, kind: type[Any]) -> Any:
    """Boxes of a row; `None` where all of its columns are null."""
    arrays = {f.name: row.rows.value(f.name, row.row) for f in fields(kind)}
    if all(array is None for array in arrays.values()):
        return None
    missing = [f.name for f in fields(kind) if f.name in BOXES_NEEDED and arrays[f.name] is None]
    if missing:
        raise DecodeError(f"boxes without {missing[0]}")
    return kind(**arrays)


_READERS: Mapping[StreamKind, Callable[[Row], Message | TruthPart]] = {
    "camera": _image, "lidar": _cloud, "radar": _scan, "pose": _pose, "truth_3d": _part, "truth_2d": _part,
}  # fmt: skip
