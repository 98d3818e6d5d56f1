"""Read regular text files of numbers as columns, all rows at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import MAX_TEXT, Float64, Int64, Text

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
        """Return float64 (N, columns); raises as `number`."""
        return np.stack([self.number(column) for column in columns], axis=1)

    def number(self, column: int) -> Float64:
        """Return float64 (N,). Raises IrregularError where one isn't a finite number."""
        found = self.table.column(column).combine_chunks()
        if not pa.types.is_floating(found.type) or found.null_count:
            raise IrregularError
        values = np.asarray(np.from_dlpack(found), np.float64)  # `to_numpy` imports pandas
        if not np.isfinite(values).all():
            raise IrregularError
        return values

    def wholes(self, column: int) -> Int64:
        """Return int64 (N,); 3.0 is whole too."""
        values = self.number(column)
        if not (np.abs(values) < _MAX_WHOLE).all() or (values != np.floor(values)).any():
            raise IrregularError
        return values.astype(np.int64)

    def texts(self, column: int) -> tuple[Text, Int64]:
        """Return the different texts (U,) and which of them each row (N,) has."""
        found = self.table.column(column)
        if not pa.types.is_dictionary(found.type) or found.null_count or found.num_chunks != 1:
            raise IrregularError
        coded = found.chunk(0)
        words = coded.dictionary.to_pylist()
        if any(len(word) > MAX_TEXT for word in words):
            raise IrregularError
        return np.array(words, np.str_), np.asarray(np.from_dlpack(coded.indices), np.int64)


def read_bytes(path: Path) -> bytes:
    """Return the content of a file; that of one that is far too large isn't plain. LogError where it can't be read."""
    try:
        return path.read_bytes() if path.stat().st_size <= _MAX_BYTES else _NOT_PLAIN
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error


@cache
def _conversion(words: int | None) -> pacsv.ConvertOptions:
    text = pa.dictionary(pa.int32(), pa.string())
    types = {f"f{i}": text if i == words else pa.float64() for i in range(_MAX_COLUMNS)}
    return pacsv.ConvertOptions(column_types=types, null_values=[""], strings_can_be_null=True)


def parse_plain(content: bytes, separator: str, words: int | None = None) -> PlainText | None:
    """Parse a text whose rows have one length; `None` where nothing is in it. One separator is between two columns, and
    column `words` has no numbers. Raises IrregularError where rows differ in length, or it is no plain text.
    """
    if not content.strip():
        return None
    if any(odd in content for odd in _ODD):
        raise IrregularError
    try:
        table = pacsv.read_csv(
            pa.BufferReader(content),
            pacsv.ReadOptions(use_threads=False, block_size=len(content) + 1, autogenerate_column_names=True),
            pacsv.ParseOptions(delimiter=separator, quote_char=False, ignore_empty_lines=True),
            _conversion(words),
        )
    except pa.ArrowException:
        raise IrregularError from None
    if table.num_columns > _MAX_COLUMNS:
        raise IrregularError
    last = table.num_columns - 1
    if last > 0 and table.column(last).null_count == table.num_rows:  # a separator ends every row
        table = table.remove_column(last)
    return PlainText(table)
