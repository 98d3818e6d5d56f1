"""Columns of Parquet tables from arrays, and arrays from columns.

pyarrow's own ways (`pa.array`, `to_numpy`, comparisons) import pandas first, which takes longer than all else that a
short replay writes and scores.
"""

from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from fbench.replay.data.arrays import Array, Bool, text_array

_FILL = {"f": np.nan, "i": -1, "u": 0, "b": False}


def number_column(values: Array, kind: pa.DataType, missing: Bool | None = None) -> pa.Array:
    """Return numbers or booleans (N,) as a column; null where `missing` (N,). Numbers mustn't change afterwards."""
    if pa.types.is_boolean(kind):
        data = np.packbits(np.asarray(values, bool), bitorder="little")
    else:
        data = np.ascontiguousarray(values, kind.to_pandas_dtype())
    return pa.Array.from_buffers(kind, len(values), [_valid(missing), pa.py_buffer(data)])


def text_column(values: Sequence[str | None]) -> pa.Array:
    """Return texts, or null, as a column."""
    missing = np.array([value is None for value in values], bool)
    return _bytes_column([(value or "").encode() for value in values], pa.string(), missing)


def bytes_column(values: Sequence[bytes]) -> pa.Array:
    """Return byte strings as a column."""
    return _bytes_column(values, pa.binary(), None)


def _bytes_column(values: Sequence[bytes], kind: pa.DataType, missing: Bool | None) -> pa.Array:
    offsets = np.cumsum([0, *map(len, values)], dtype=np.int64)
    if offsets[-1] > np.iinfo(np.int32).max:
        raise ValueError(f"a column of {offsets[-1]} bytes, more than 2 GiB")
    buffers = [_valid(missing), pa.py_buffer(offsets.astype(np.int32)), pa.py_buffer(b"".join(values))]
    return pa.Array.from_buffers(kind, len(values), buffers)


def row_column(values: Array, missing: Bool | None = None) -> pa.Array:
    """Return rows (N, K) of float64 as a column of lists of K; null where `missing` (N,)."""
    mask = None if missing is None else number_column(missing, pa.bool_())
    return pa.FixedSizeListArray.from_arrays(number_column(values.ravel(), pa.float64()), values.shape[1], mask=mask)


def _valid(missing: Bool | None) -> pa.Buffer | None:
    if missing is None or not missing.any():
        return None
    return pa.py_buffer(np.packbits(~missing, bitorder="little"))


def column_array(column: pa.ChunkedArray) -> Array:
    """Return a column as an array; nulls become NaN, -1 or empty."""
    chunk = column.combine_chunks()
    if isinstance(chunk, pa.ChunkedArray):
        chunk = pa.concat_arrays(chunk.chunks) if chunk.num_chunks else pa.nulls(0, column.type)
    if pa.types.is_dictionary(chunk.type):
        chunk = chunk.dictionary_decode()
    if pa.types.is_fixed_size_list(chunk.type):
        size = chunk.type.list_size
        rows = np.array(_numbers(chunk.values.slice(chunk.offset * size, len(chunk) * size))).reshape(-1, size)
        if chunk.null_count:
            rows[~_bits(chunk.buffers()[0], chunk)] = np.nan
        return rows
    if pa.types.is_string(chunk.type):
        return text_array(["" if text is None else text for text in chunk.to_pylist()])
    return _numbers(chunk)


def _numbers(chunk: pa.Array) -> Array:
    dtype, (valid, data) = np.dtype(chunk.type.to_pandas_dtype()), chunk.buffers()
    if pa.types.is_boolean(chunk.type):
        values = _bits(data, chunk)
    else:
        values = np.frombuffer(data or b"", dtype)[chunk.offset : chunk.offset + len(chunk)]
    return values if not chunk.null_count else np.where(_bits(valid, chunk), values, dtype.type(_FILL[dtype.kind]))


def _bits(buffer: pa.Buffer | None, chunk: pa.Array) -> Bool:
    bits = np.unpackbits(np.frombuffer(buffer or b"", np.uint8), bitorder="little").astype(bool)
    return bits[chunk.offset : chunk.offset + len(chunk)]
