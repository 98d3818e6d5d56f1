"""Text files of boxes as columns: regular ones at once, others row by row."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from fbench.metrics.core.sequence import Objects
from fbench.metrics.files.side import nothing, objects_of
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import MAX_TEXT, Float64, Int64, Text, text_array
from fbench.replay.formats.objects import Labelled

_MAX_BYTES = 512 * 2**20
_MAX_WHOLE = 2**53
_MAX_COLUMNS = 32
_NOT_PLAIN = b"\0"
_ODD = (b'"', _NOT_PLAIN, b"\xef\xbb\xbf")


class IrregularError(Exception):
    """Not a plain table of numbers: read it row by row."""


@dataclass(frozen=True)
class PlainText:
    """Columns of a text without a header, all rows of one length."""

    table: pa.Table

    def __len__(self) -> int:
        return int(self.table.num_rows)

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.table.num_columns)

    def numbers(self, columns: Sequence[int]) -> Float64:
        """Return float64 (N, columns).

        Raises:
            IrregularError: where one isn't a number.
        """
        return np.stack([self._numbers(column) for column in columns], axis=1)

    def number(self, column: int) -> Float64:
        """Return float64 (N,)."""
        return self._numbers(column)

    def wholes(self, column: int) -> Int64:
        """Return int64 (N,); 3.0 is whole too."""
        values = self._numbers(column)
        if not (np.abs(values) < _MAX_WHOLE).all() or (values != np.floor(values)).any():
            raise IrregularError
        return values.astype(np.int64)

    def texts(self, column: int) -> tuple[Text, Int64]:
        """Return the different texts (U,) and which of them each row (N,) has."""
        found = self.table.column(column).combine_chunks()
        if not pa.types.is_string(found.type) or found.null_count:
            raise IrregularError
        coded = found.dictionary_encode()
        words = coded.dictionary.to_pylist()
        if any(len(word) > MAX_TEXT for word in words):
            raise IrregularError
        return np.array(words, np.str_), np.asarray(coded.indices.to_numpy(zero_copy_only=False), np.int64)

    def _numbers(self, column: int) -> Float64:
        found = self.table.column(column).combine_chunks()
        if not pa.types.is_floating(found.type) or found.null_count:
            raise IrregularError
        values = np.asarray(found.to_numpy(zero_copy_only=False), np.float64)
        if not np.isfinite(values).all():
            raise IrregularError
        return values


def read_plain(path: Path, separator: str, words: int | None = None) -> PlainText | None:
    """Read a text whose rows have one length; `None` where nothing is in it.

    Args:
        path: The file.
        separator: Between columns, one each time.
        words: Column that has no numbers.

    Raises:
        IrregularError: where rows differ in length, or it is no plain text.
        LogError: where it can't be read.
    """
    return parse_plain(read_bytes(path), separator, words)


def read_bytes(path: Path) -> bytes:
    """Return the content of a file; that of one that is far too large isn't plain.

    Raises:
        LogError: where it can't be read.
    """
    try:
        return path.read_bytes() if path.stat().st_size <= _MAX_BYTES else _NOT_PLAIN
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error


def parse_plain(content: bytes, separator: str, words: int | None = None) -> PlainText | None:
    """Do what `read_plain` does with the content of files.

    Raises:
        IrregularError: where rows differ in length, or it is no plain text.
    """
    if not content.strip():
        return None
    if any(odd in content for odd in _ODD):
        raise IrregularError
    types = {f"f{i}": pa.string() if i == words else pa.float64() for i in range(_MAX_COLUMNS)}
    try:
        table = pacsv.read_csv(
            pa.BufferReader(content),
            pacsv.ReadOptions(use_threads=False, block_size=len(content) + 1, autogenerate_column_names=True),
            pacsv.ParseOptions(delimiter=separator, quote_char=False, ignore_empty_lines=True),
            pacsv.ConvertOptions(column_types=types, null_values=[""], strings_can_be_null=True),
        )
    except pa.ArrowException:
        raise IrregularError from None
    if table.num_columns > _MAX_COLUMNS:
        raise IrregularError
    return PlainText(_without_tail(table))


def _without_tail(table: pa.Table) -> pa.Table:
    """Drop the empty column that a separator at the end of all rows makes."""
    last = table.num_columns - 1
    is_empty = last > 0 and table.column(last).null_count == table.num_rows
    return table.remove_column(last) if is_empty else table


_NONE3 = (np.nan,) * 3
_NONE4 = (np.nan,) * 4


def columns_of(steps: Sequence[int], rows: Sequence[Labelled]) -> Objects:
    """Return labelled objects as columns; labels are the source's words in lower case.

    Args:
        steps: Frame or stamp of each row.
        rows: The objects.
    """
    if not rows:
        return nothing()
    solids = [row.solid for row in rows]
    flats = [row.flat for row in rows]
    has_solid, has_flat = any(s is not None for s in solids), any(f is not None for f in flats)
    yaws = [np.nan if s is None else s.yaw_pitch_roll_rad[0] for s in solids]
    found, _ = objects_of(
        {
            "step": np.array(steps, np.int64),
            "label": text_array([row.source_label.lower() for row in rows]),
            "track_id": np.array([-1 if row.track_id is None else row.track_id for row in rows], np.int64),
            "score": np.array([0.0 if row.score is None else row.score for row in rows]),
            "xyxy_px": np.array([_NONE4 if f is None else f.xyxy_px for f in flats]) if has_flat else None,
            "center_m": np.array([_NONE3 if s is None else s.center_m for s in solids]) if has_solid else None,
            "size_lwh_m": np.array([_NONE3 if s is None else s.size_lwh_m for s in solids]) if has_solid else None,
            "yaw_rad": np.array(yaws) if has_solid else None,
            "velocity_mps": _velocities(rows),
            "alpha_rad": _numbers([row.alpha_rad for row in rows]),
            "occlusion": _numbers([row.occlusion for row in rows]),
            "truncation": _numbers([row.truncation for row in rows]),
            "visibility": _numbers([row.visibility for row in rows]),
            "attribute": text_array([row.attribute or "" for row in rows]) if any(r.attribute for r in rows) else None,
            "num_points": _counts([row.num_lidar_pts for row in rows]),
            "ignore": _flags([row.ignore for row in rows]),
        }
    )
    return found


def _numbers(values: Sequence[float | None]) -> Float64 | None:
    if all(value is None for value in values):
        return None
    return np.array([np.nan if value is None else value for value in values], np.float64)


def _counts(values: Sequence[int | None]) -> np.ndarray | None:
    if all(value is None for value in values):
        return None
    return np.array([-1 if value is None else value for value in values], np.int64)


def _flags(values: Sequence[bool | None]) -> np.ndarray | None:
    return np.array([bool(value) for value in values]) if any(values) else None


def _velocities(rows: Sequence[Labelled]) -> Float64 | None:
    told = [None if row.solid is None else row.solid.velocity_mps for row in rows]
    return None if all(v is None for v in told) else np.array([_NONE3 if v is None else v for v in told])
