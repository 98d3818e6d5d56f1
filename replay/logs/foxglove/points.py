"""Packed points of `foxglove.PointCloud`: columns of any numeric type, interleaved."""

from collections.abc import Mapping, Sequence

import numpy as np
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField as Field
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as CloudProto
from numpy.typing import DTypeLike

from fbench.replay.arrays import Array, Float32
from fbench.replay.errors import PointsError

_DTYPES = {
    Field.UINT8: "<u1", Field.INT8: "<i1", Field.UINT16: "<u2", Field.INT16: "<i2",
    Field.UINT32: "<u4", Field.INT32: "<i4", Field.FLOAT32: "<f4", Field.FLOAT64: "<f8",
}  # fmt: skip
_TYPES = {np.dtype(dtype): kind for kind, dtype in _DTYPES.items()}


def pack(proto: CloudProto, xyz: Float32, columns: Mapping[str, Array | None]) -> None:
    """Fill fields, stride and data of `proto`; columns that are `None` are left out."""
    named: dict[str, Array] = {axis: xyz[:, i] for i, axis in enumerate("xyz")}
    named |= {name: column for name, column in columns.items() if column is not None}
    dtype = np.dtype([(name, column.dtype.newbyteorder("<")) for name, column in named.items()])
    rows = np.empty(len(xyz), dtype)
    offset = 0
    for name, column in named.items():
        rows[name] = column
        proto.fields.add(name=name, offset=offset, type=_TYPES[column.dtype.newbyteorder("<")])
        offset += column.dtype.itemsize
    proto.point_stride = dtype.itemsize
    proto.data = rows.tobytes()


class Columns:
    """The points of one message by column name in lower case; the first one of a name counts."""

    def __init__(self, proto: CloudProto, data: memoryview) -> None:
        self._data = data
        self._stride = proto.point_stride
        self._fields: dict[str, Field] = {}
        for field in proto.fields:
            self._fields.setdefault(field.name.lower(), field)
        if self._stride == 0 and self._data:
            raise PointsError("points of 0 bytes")
        if self._stride and len(self._data) % self._stride:
            raise PointsError(f"{len(self._data)} bytes aren't a multiple of the point stride {self._stride}")
        self._num = len(self._data) // self._stride if self._stride else 0

    def xyz(self) -> Float32:
        """Coordinates (N, 3) float32.

        Raises:
            PointsError: where x, y or z is missing.
        """
        missing = [axis for axis in "xyz" if axis not in self._fields]
        if missing:
            raise PointsError(f"points have no field {', '.join(missing)}")
        axes = [self._fields[axis] for axis in "xyz"]
        x = axes[0].offset
        if all(f.type == Field.FLOAT32 and f.offset == x + 4 * i for i, f in enumerate(axes)):
            self._check(axes[2])
            return self._strided(x, "<f4", 3)
        return np.stack([_cast(self._column(field), "f4") for field in axes], axis=1)

    def get(self, names: Sequence[str], dtype: DTypeLike | None = None) -> Array | None:
        """The first of these columns that is there, (N,), converted to `dtype` if given; `None` where there is none.

        Raises:
            PointsError: where the column has an unknown type or lies outside the points.
        """
        field = next((self._fields[name] for name in names if name in self._fields), None)
        if field is None:
            return None
        return self._column(field) if dtype is None else _cast(self._column(field), dtype)

    def _check(self, field: Field) -> np.dtype[np.generic]:
        if field.type not in _DTYPES:
            raise PointsError(f"field '{field.name}' has an unknown type {field.type}")
        dtype = np.dtype(_DTYPES[field.type])
        if self._num and field.offset + dtype.itemsize > self._stride:
            raise PointsError(f"field '{field.name}' lies outside the points of {self._stride} bytes")
        return dtype

    def _column(self, field: Field) -> Array:
        return self._strided(field.offset, self._check(field), 1)[:, 0]

    def _strided(self, offset: int, dtype: DTypeLike, width: int) -> Array:
        """Copy of (N, width) consecutive values at `offset` of each point; the only copy that is made of them."""
        dtype = np.dtype(dtype)
        if not self._num:
            return np.zeros((0, width), dtype)
        # As opaque items the values of a point are copied at once, which takes half the time.
        items = np.ndarray(self._num, f"V{width * dtype.itemsize}", self._data, offset, self._stride)
        return items.copy().view(dtype).reshape(self._num, width)


def _cast(column: Array, dtype: DTypeLike) -> Array:
    """Convert, values out of range as NumPy does it: foreign logs store rings as floats, intensities as integers."""
    with np.errstate(over="ignore", invalid="ignore"):
        return column.astype(dtype, copy=False)
