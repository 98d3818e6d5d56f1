"""Rows of a decoded row group, and the messages that they hold; large values are views."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pyarrow as pa

from fbench.replay.contracts.errors import DataError, DecodeError
from fbench.replay.data.arrays import Array, Bool, text_array
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan, Truth
from fbench.replay.logs.codecs.codec import TruthPart
from fbench.replay.logs.containers.limits import MAX_FRAME_NUMBER
from fbench.replay.logs.containers.parquet.columns import BOXES_NEEDED, Column, Content, StreamKind

_DTYPES = {Content.INTS: "i8", Content.SMALL: "u1", Content.FLAGS: "?"}  # All other lists hold floats, "f8"
_WIDTHS = {Content.VECS3: 3, Content.VECS4: 4}
T = TypeVar("T")


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
    """The columns of a row group by name. Raises ValueError or pa.ArrowException where a value isn't of its type."""

    def __init__(self, table: pa.Table, columns: Mapping[str, Column]) -> None:
        self.num = int(table.num_rows)
        self.numbers: dict[str, Numbers] = {}
        self.blobs: dict[str, Blobs] = {}
        self.others: dict[str, tuple[pa.Array, Content]] = {}  # Texts, flags and lists
        for name, column in columns.items():
            chunked, content = table.column(name), column.content
            array = chunked.chunk(0) if chunked.num_chunks == 1 else chunked.combine_chunks()
            if content in (Content.INT, Content.UINT):
                self.numbers[name] = Numbers(array.cast(content.value).fill_null(0).to_numpy(), _valid(array))
            elif content is Content.BYTES:
                self.blobs[name] = _blobs(array)
            else:
                self.others[name] = (array, content)


def _valid(array: pa.Array) -> Bool:
    return np.asarray(array.is_valid().to_numpy(zero_copy_only=False))


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
    dtype = np.dtype(_DTYPES.get(content, "f8"))
    array = np.asarray(values.to_numpy(zero_copy_only=False)).astype(dtype, casting="same_kind", copy=False)
    return array if width is None else array.reshape(num, width)


def _need(name: str, value: T | None) -> T:
    if value is None:
        raise DecodeError(f"{name} is null")
    return value


class Row(NamedTuple):
    """One message; implements `fbench.replay.logs.container.Stored`."""

    rows: Rows
    row: int
    kind: StreamKind
    sensor: str

    def read(self) -> Message | TruthPart:
        """Decode the row. Raises DecodeError where its columns don't fit together."""
        try:
            return self._read()
        except DataError as error:
            raise DecodeError(str(error)) from error

    def _read(self) -> Message | TruthPart:
        head = (self.sensor, _need("stamp_ns", self.number("stamp_ns")), _need("log_ns", self.number("log_ns")))
        match self.kind:
            case "camera":
                size_wh = (_need("width", self.number("width")), _need("height", self.number("height")))
                if min(size_wh) < 0:
                    raise DecodeError(f"image of {size_wh[0]}x{size_wh[1]}")
                data, encoding = bytes(_need("data", self.blob("data"))), _need("encoding", self._value("encoding"))
                return Image(*head, data, encoding, size_wh, self._frame_number())
            case "lidar":
                more = (self._unpack("intensity"), self._unpack("ring", "<u2"), self._unpack("offset_ns", "<i4"))
                return PointCloud(*head, self._xyz(), *more, self._frame_number())
            case "radar":
                return RadarScan(
                    *head, self._xyz(), self._unpack("radial_velocity_mps"), self._unpack("rcs_dbsm"),
                    self._unpack("range_m"), self._unpack("azimuth_rad"), self._unpack("altitude_rad"),
                    self._frame_number(),
                )  # fmt: skip
            case "pose":
                translation_m = _need("translation_m", self._value("translation_m"))
                rotation_xyzw = _need("rotation_xyzw", self._value("rotation_xyzw"))
                return Pose(*head, translation_m, rotation_xyzw, self._frame_number())
            case _:
                is_2d = self.kind == "truth_2d"
                frame_id, expects_2d = self._value("frame_id") or "", bool(self._value("expects_2d"))
                boxes3d, boxes2d = (None, self._boxes(Boxes2D)) if is_2d else (self._boxes(Boxes3D), None)
                truth = Truth(head[1], head[2], boxes3d, boxes2d, self._frame_number())
                return TruthPart(truth, is_2d, expects_2d, frame_id)

    def number(self, name: str) -> int | None:
        """Return an integer; `None` where it is null or the column isn't there."""
        column = self.rows.numbers.get(name)
        return None if column is None else column.get(self.row)

    def blob(self, name: str) -> memoryview | None:
        """Return binary data; `None` where it is null or the column isn't there."""
        column = self.rows.blobs.get(name)
        return None if column is None else column.get(self.row)

    def _value(self, name: str) -> Any:
        """A text, flag or list; `None` where it is null or the column isn't there. Raises DecodeError where it isn't
        Unicode, has nulls inside, or vectors of another width.
        """
        if name not in self.rows.others:
            return None
        array, content = self.rows.others[name]
        scalar = array[self.row]
        try:
            if not content.is_nested:
                return scalar.as_py()
            return _list(scalar, content) if scalar.is_valid else None
        except (ValueError, pa.ArrowException) as error:
            raise DecodeError(f"{name}: {error}") from error

    def _unpack(self, name: str, dtype: str = "<f4") -> Array | None:
        """The numbers that are packed into binary data, as a view; `None` where there are none."""
        data = self.blob(name)
        if data is None:
            return None
        if len(data) % np.dtype(dtype).itemsize:
            raise DecodeError(f"{name} has {len(data)} bytes, which aren't whole numbers of type {dtype}")
        array = np.frombuffer(data, dtype)
        return array if array.flags.aligned else array.copy()

    def _xyz(self) -> Array:
        """Coordinates (N, 3), the number of which is checked."""
        xyz = _need("xyz", self._unpack("xyz"))
        if len(xyz) % 3:
            raise DecodeError(f"xyz has {len(xyz)} values, which aren't points")
        claimed = self.number("num_points")
        if claimed is not None and claimed * 3 != len(xyz):
            raise DecodeError(f"num_points is {claimed}, xyz has {len(xyz) // 3} points")
        return xyz.reshape(-1, 3)

    def _boxes(self, kind: type[Any]) -> Any:
        """Boxes of a row; `None` where all of its columns are null."""
        arrays = {f.name: self._value(f.name) for f in fields(kind)}
        if all(array is None for array in arrays.values()):
            return None
        for name, array in arrays.items():
            if array is None and name in BOXES_NEEDED:
                raise DecodeError(f"boxes without {name}")
        return kind(**arrays)

    def _frame_number(self) -> int | None:
        number = self.number("frame_number")
        if number is not None and not 0 <= number <= MAX_FRAME_NUMBER:
            raise DecodeError(f"frame_number {number} is outside 0 to {MAX_FRAME_NUMBER}")
        return number
