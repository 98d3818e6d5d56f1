"""Named arrays with one row a track: what a track carries along, without the checks of whole boxes."""

from typing import TypeAlias

import numpy as np

from fbench.replay.arrays import Array

Columns: TypeAlias = dict[str, Array]
"""Arrays (T, ...) by name, all with equally many rows."""


def rows(columns: Columns, at: Array) -> Columns:
    """Select rows by mask or index array."""
    return {name: column[at] for name, column in columns.items()}


def joined(first: Columns, second: Columns) -> Columns:
    """Put rows of the same columns one below the other."""
    return {name: np.concatenate([column, second[name]]) for name, column in first.items()}


def overwritten(columns: Columns, at: Array, new: Columns) -> Columns:
    """Replace the rows `at` by those of `new`."""
    return {name: overwritten_rows(column, at, new[name]) for name, column in columns.items()}


def overwritten_rows(column: Array, at: Array, new: Array) -> Array:
    """Replace the rows `at` of one array; texts get the room that the longest one needs."""
    result = column.astype(np.result_type(column, new)) if column.dtype.kind == "U" else column.copy()
    result[at] = new
    return result
