"""How much memory the pages of a column chunk take when they are decoded, from their headers alone.

pyarrow takes the sizes that a file claims. A damaged or hostile file can claim anything, so they are bounded first.
Ids of fields are those of `PageHeader` in parquet-format.
"""

from collections.abc import Callable
from typing import NamedTuple

from fbench.replay.errors import LimitError, LogError
from fbench.replay.logs.parquet.thrift import number, read_struct, struct

MAX_DECODED = 256 * 1024 * 1024
"""Row groups that would take more are read piece by piece; what can't be cut into such pieces is refused [byte]."""
_UNPACKED, _STORED = 2, 3
_DATA, _DICTIONARY, _DATA_V2 = 5, 7, 8
_NUM_VALUES, _ENCODING, _ENCODING_V2 = 1, 2, 4
_PLAIN = 0
_DICTIONARY_CODES = (2, 8)
_PER_VALUE = 16
"""At least so many bytes are taken for a value: offset, level, number."""
_GROWING = {6: "DELTA_LENGTH_BYTE_ARRAY", 7: "DELTA_BYTE_ARRAY"}


class Page(NamedTuple):
    """What the header of a page says."""

    header: int
    """Size of the header [byte]."""
    stored: int
    unpacked: int
    num_values: int
    encoding: int
    is_dictionary: bool


def decoded_size(where: str, fetch: Callable[[int], memoryview], length: int, is_bytes: bool) -> int:
    """Return a bound for the memory that a column chunk of `length` bytes takes when it is read [byte].

    `fetch` gives some bytes of the chunk from a position on, enough for a page header.

    Raises:
        DamageError: where these bytes aren't pages.
        LogError: where one page would take more than `MAX_DECODED`, or its encoding has no bound.
    """
    at = total = largest = dictionary = 0
    while at < length:
        page = read_page(fetch(at))
        total += _values_size(where, page, dictionary if is_bytes else 0)
        largest = max(largest, page.unpacked)
        if page.is_dictionary:
            dictionary = page.unpacked
        at += page.header + page.stored
    return total + largest


def _values_size(where: str, page: Page, dictionary: int) -> int:
    if page.encoding in _GROWING:
        name = _GROWING[page.encoding]
        raise LogError(f"{where}: encoding {name} can't be bounded in memory; write the column as PLAIN", "PQ001")
    is_coded = page.encoding in _DICTIONARY_CODES and not page.is_dictionary
    size = page.num_values * _PER_VALUE + (0 if is_coded else page.unpacked)
    if size + page.unpacked > MAX_DECODED:
        taken = f"a page takes {size + page.unpacked} bytes, the limit is {MAX_DECODED}"
        raise LimitError(f"{where}: {taken}; write smaller row groups", "LIM004")
    return size + (page.num_values * dictionary if is_coded else 0)


def read_page(data: memoryview) -> Page:
    """Read the page header at the start of `data`.

    Raises:
        DamageError: where there is none.
    """
    fields, end = read_struct(data)
    unpacked, stored = number(fields, _UNPACKED), number(fields, _STORED)
    kind = next((k for k in (_DATA, _DICTIONARY, _DATA_V2) if k in fields), None)
    if kind is None:  # an index page has no values
        return Page(end, stored, unpacked, 0, _PLAIN, False)
    inner = struct(fields, kind)
    encoding = number(inner, _ENCODING_V2 if kind == _DATA_V2 else _ENCODING)
    return Page(end, stored, unpacked, number(inner, _NUM_VALUES), encoding, kind == _DICTIONARY)
