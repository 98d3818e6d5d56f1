"""The rows of a table by instant: whole instants at once, in order."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from fbench.replay.arrays import Int64
from fbench.replay.boxfiles.table_files import TableFile
from fbench.replay.boxfiles.table_values import Values
from fbench.replay.errors import LimitError, LogError

KEYS = ("stamp_ns", "stamp_s", "frame")
_MAX_UNORDERED = 5_000_000
_MAX_AT_ONCE = 200_000
_ROWS_AT_ONCE = 16384


@dataclass(frozen=True)
class Key:
    """What says when the boxes of a row were."""

    name: str

    @property
    def is_frame(self) -> bool:
        """Whether frames are counted."""
        return self.name == "frame"

    def read(self, values: Values) -> Int64:
        """Return stamps [ns] or frames (N,).

        Raises:
            LogError: naming the row where there is none.
        """
        if self.name == "stamp_ns" and pa.types.is_floating(values.table.column("stamp_ns").type):
            raise LogError(f"{values.path}: stamp_ns is a float, which loses nanoseconds; store it as int64")
        found = values.seconds(self.name) if self.name == "stamp_s" else values.wholes(self.name)
        if len(found) and found.min() < 0:
            index = int(np.argmax(found < 0))
            raise LogError(f"{values.where(index)}: {self.name} is missing or negative")
        return found


def key_of(file: TableFile) -> Key:
    """Return the column that says when boxes were.

    Raises:
        LogError: where there is none.
    """
    name = next((name for name in KEYS if name in file.names), None)
    if name is None:
        raise LogError(f"{file.path}: no column says when boxes were; expected {', '.join(KEYS[:-1])} or {KEYS[-1]}")
    return Key(name)


def instants(file: TableFile, key: Key) -> Iterator[tuple[Int64, Values]]:
    """Yield rows with their keys, ascending, never parting those of one instant.

    Raises:
        LimitError: where more rows than memory allows aren't in order, or belong to one instant.
    """
    num_rows, is_ordered = _survey(file, key)
    if is_ordered:
        batches: Iterator[pa.Table] = file.batches()
    elif num_rows > _MAX_UNORDERED:
        raise LimitError(f"{file.path}: {num_rows} rows that aren't in the order of '{key.name}'; sort them")
    else:
        batches = _ordered(file, key)
    kept: pa.Table | None = None
    for batch in batches:
        table = batch if kept is None else pa.concat_tables([kept, batch])
        values = Values(file.path, table)
        keys = key.read(values)
        last = int(np.searchsorted(keys, keys[-1])) if len(keys) else 0
        if len(keys) - last > _MAX_AT_ONCE:
            raise LimitError(f"{file.path}: over {_MAX_AT_ONCE} rows at '{key.name}' {keys[-1]}")
        if last:
            yield keys[:last], Values(file.path, table.slice(0, last))
        kept = table.slice(last)
    if kept is not None and kept.num_rows:
        values = Values(file.path, kept)
        yield key.read(values), values


def _survey(file: TableFile, key: Key) -> tuple[int, bool]:
    """Count the rows, and tell whether they are in order."""
    num_rows, last, is_ordered = 0, -1, True
    for batch in file.batches([key.name]):
        keys = key.read(Values(file.path, batch))
        if len(keys):
            is_ordered = is_ordered and int(keys[0]) >= last and bool((np.diff(keys) >= 0).all())
            last, num_rows = int(keys[-1]), num_rows + len(keys)
    return num_rows, is_ordered


def _ordered(file: TableFile, key: Key) -> Iterator[pa.Table]:
    table = pa.concat_tables(list(file.batches()))
    order = np.argsort(key.read(Values(file.path, table)), kind="stable")
    for start in range(0, len(order), _ROWS_AT_ONCE):
        yield table.take(pa.array(order[start : start + _ROWS_AT_ONCE]))
