"""Columns of tables: equal to those of pyarrow's own functions, and read back as they were."""

import numpy as np
import pyarrow as pa
import pytest

from fbench.replay.runs.columns import bytes_column, column_array, number_column, row_column, text_column

KINDS = [
    (np.arange(-3, 8), pa.int64()),
    (np.arange(11, dtype=np.uint8), pa.uint8()),
    (np.array([0.5, np.nan, np.inf, -2, *range(7)]), pa.float64()),
    (np.arange(11) % 3 == 0, pa.bool_()),
]
FILL = {"f": np.nan, "i": -1, "u": 0, "b": False}


@pytest.mark.parametrize(
    ("values", "kind"), KINDS, ids=lambda value: str(value) if isinstance(value, pa.DataType) else ""
)
@pytest.mark.parametrize("num", [0, 1, 11])
def test_numbers(values, kind, num):
    values = values[:num]
    assert number_column(values, kind).equals(pa.array(values, kind)) or values.dtype.kind == "f"
    np.testing.assert_array_equal(column_array(pa.chunked_array([number_column(values, kind)])), values)
    missing = np.arange(num) % 4 == 1
    column = number_column(values, kind, missing)
    column.validate(full=True)
    assert column.null_count == missing.sum()
    expected = np.where(missing, values.dtype.type(FILL[values.dtype.kind]), values)
    for cut in (slice(None), slice(3, 9)):  # a part of a column begins within a byte of bits
        part = pa.chunked_array([column[cut], column[:0]])
        np.testing.assert_array_equal(column_array(part), expected[cut])
    np.testing.assert_array_equal(column_array(pa.chunked_array([column, column])), np.tile(expected, 2))


def test_texts_and_bytes():
    texts = ["", "ä\0b", None, "x" * 300, "\U0001f697"]
    assert text_column(texts).equals(pa.array(texts, pa.string()))
    assert column_array(pa.chunked_array([text_column(texts)[1:]])).tolist() == ["ä\0b", "", "x" * 300, "\U0001f697"]
    assert column_array(pa.chunked_array([text_column(["b", "a", "b"]).dictionary_encode()])).tolist() == [
        "b",
        "a",
        "b",
    ]
    assert bytes_column([b"", b"\xff\0", b"a"]).equals(pa.array([b"", b"\xff\0", b"a"]))
    assert text_column([]).equals(pa.array([], pa.string()))


def test_rows():
    rows, missing = np.arange(21.0).reshape(7, 3), np.arange(7) % 3 == 1
    assert row_column(rows).equals(pa.array(rows.tolist(), pa.list_(pa.float64(), 3)))
    expected = np.where(missing[:, None], np.nan, rows)
    for cut in (slice(None), slice(2, 6)):
        np.testing.assert_array_equal(column_array(pa.chunked_array([row_column(rows, missing)[cut]])), expected[cut])
    np.testing.assert_array_equal(column_array(pa.chunked_array([row_column(rows[:0])])), rows[:0])
