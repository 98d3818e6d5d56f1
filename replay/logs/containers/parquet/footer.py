"""Footer of a Parquet file, verified before it is parsed, and Thrift's compact protocol.

pyarrow reads them too, but shows a page's header to nobody, and ends the process where a footer's numbers contradict
each other (as of version 26).
"""

import errno
import os
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias, TypeVar

import pyarrow as pa
import pyarrow.parquet as pq

from fbench.replay.contracts.errors import LimitError, LogError
from fbench.replay.logs.containers.limits import crc32, looks_like
from fbench.replay.logs.containers.parquet.columns import Column, StreamKind, present_columns
from fbench.replay.logs.containers.parquet.log_json import Checksums

_FLAGS = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK  # A FIFO would block, and a link could lead anywhere
_MAX_DEPTH = 16
_TRUE, _FALSE, _BYTE, _STRUCT = 1, 2, 3, 12
MAGIC = b"PAR1"
# Ids of fields in parquet-format: FileMetaData, RowGroup, ColumnChunk, ColumnMetaData.
_ROW_GROUPS = 4
_COLUMNS, _GROUP_ROWS = 1, 3
_ABOUT = 3
_PHYSICAL_TYPE, _PATH, _STORED_SIZE, _DATA_PAGE, _DICTIONARY_PAGE = 1, 3, 7, 9, 11
_BYTE_ARRAY = 6
_END = 8
_MAX_FOOTER = 32 * 1024 * 1024
MAX_ZEROS = 400_000
"""In Thrift's compact protocol each struct ends with a byte 0; parsing takes up to about 600 bytes for each."""
MAX_CHUNKS = 400_000  # Column chunks of all files of a log, of which their footers hold about as much in memory
ZEROS_PER_CHUNK = 12  # At most so many has a footer that fbench writes, for each row group and column

Value: TypeAlias = "int | bytes | Struct | list[Struct] | None"
Struct: TypeAlias = "dict[int, Value]"
T = TypeVar("T", int, dict[Any, Any], list[Any])


class DamageError(Exception):
    """Bytes that aren't what they should be, with the reason."""


@contextmanager
def open_regular(path: Path) -> Iterator[BinaryIO]:
    """Open a regular file for reading. Raises LogError where it isn't there, isn't a regular file or can't be read."""
    try:
        number = os.open(path, _FLAGS)
        with os.fdopen(number, "rb", buffering=0) as file:
            if not stat.S_ISREG(os.fstat(number).st_mode):
                raise LogError(f"{path}: not a regular file", "PQ001")
            yield file
    except FileNotFoundError:
        raise LogError(f"{path}: is missing", "PQ001") from None
    except OSError as error:
        reason = "a link, which could lead out of the log" if error.errno == errno.ELOOP else error.strerror
        raise LogError(f"{path}: can't be read ({reason})", "PQ001") from error


def read_struct(data: memoryview, at: int = 0, depth: int = 0) -> tuple[Struct, int]:
    """Read a struct; returns its fields by id, and where it ends. Of lists only those of structs are kept. Raises
    DamageError where there is none.
    """
    fields: Struct = {}
    key = 0
    try:
        while head := data[at]:
            at += 1
            if head >> 4:
                key += head >> 4
            else:
                key, at = _zigzag(data, at)
            fields[key], at = _read_value(data, at, head & 15, depth)
    except IndexError:
        raise DamageError("a struct is cut off") from None
    return fields, at + 1


def get(fields: Struct, key: int, kind: type[T]) -> T:
    """Return a number that isn't negative, a struct or a list of structs. Raises DamageError where it isn't there."""
    value = fields.get(key)
    if not isinstance(value, kind) or (isinstance(value, int) and value < 0):
        missing = {int: "number is missing or negative", dict: "struct is missing", list: "list is missing"}
        raise DamageError(f"a {missing[kind]}")
    return value


def _read_value(data: memoryview, at: int, kind: int, depth: int) -> tuple[Value, int]:
    if depth > _MAX_DEPTH:
        raise DamageError("structs or lists are nested too deeply")
    match kind:
        case 1 | 2:  # the value of a flag is in its type
            return kind == _TRUE, at
        case 3:
            return data[at], at + 1
        case 4 | 5 | 6:
            return _zigzag(data, at)
        case 7:
            if at + 8 > len(data):  # a list of them may claim any number
                raise IndexError
            return None, at + 8
        case 8:
            length, at = _varint(data, at)
            return bytes(data[at : at + length]), at + length
        case 9 | 10:
            return _read_list(data, at, depth + 1)
        case 12:
            return read_struct(data, at, depth + 1)
        case _:
            raise DamageError(f"a field has the unknown type {kind}")


def _read_list(data: memoryview, at: int, depth: int) -> tuple[Value, int]:
    """All of a list of structs; of others the first item, which for the path of a column is its name."""
    kind, num = data[at] & 15, data[at] >> 4
    at += 1
    if num == 15:
        num, at = _varint(data, at)
    found: list[Struct] = []
    first: Value = None
    kind = _BYTE if kind in (_TRUE, _FALSE) else kind  # flags in lists have a byte each
    for i in range(num):
        value, at = _read_value(data, at, kind, depth)
        if isinstance(value, dict):
            found.append(value)
        elif i == 0:
            first = value
    return found if kind == _STRUCT else first, at


def _zigzag(data: memoryview, at: int) -> tuple[int, int]:
    value, at = _varint(data, at)
    return (value >> 1) ^ -(value & 1), at


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        byte = data[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
    raise DamageError("a number is too long")


@dataclass(frozen=True)
class Chunk:
    """Where a row group holds one column, or one leaf of a nested one."""

    column: str
    offset: int
    length: int
    is_bytes: bool


@dataclass(frozen=True, eq=False)
class Group:
    """One row group."""

    num_rows: int
    chunks: Sequence[Chunk]


@dataclass(frozen=True, eq=False)
class Footer:
    """A file as its footer describes it."""

    size: int  # Of the file [byte]
    metadata: Any  # The footer as pyarrow wants it
    columns: Mapping[str, Column]  # The documented columns that it has
    groups: Sequence[Group]  # All row groups, of which each lies inside the file

    def chunks(self, group: int) -> list[Chunk]:
        """Where the documented columns of a row group are."""
        return [chunk for chunk in self.groups[group].chunks if chunk.column in self.columns]


def _chunk(fields: Struct, data_end: int) -> Chunk:
    about = get(fields, _ABOUT, dict)
    name = about.get(_PATH)
    start, length = get(about, _DATA_PAGE, int), get(about, _STORED_SIZE, int)
    if about.get(_DICTIONARY_PAGE):
        start = min(start, get(about, _DICTIONARY_PAGE, int))
    if not isinstance(name, bytes) or start + length > data_end:
        raise DamageError("a row group lies outside the file")
    return Chunk(name.decode(errors="replace"), start, length, get(about, _PHYSICAL_TYPE, int) == _BYTE_ARRAY)


def read_footer(path: Path, kind: StreamKind, sums: Checksums | None) -> Footer:
    """Read and check the footer of a stream's file. Raises LogError where the file is missing, truncated, damaged, not
    Parquet or lacks columns.
    """
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if sums is not None and size != sums.size:
            reason = "truncated" if size < sums.size else "changed"
            raise LogError(f"{path}: {reason}, it has {size} bytes instead of {sums.size}", "PQ001")
        tail = read_tail(path, file, size)
    if sums is not None and crc32(tail) != sums.footer_crc32:
        raise LogError(f"{path}: damaged, the checksum of its footer doesn't match", "PQ001")
    require_parsable(path, tail)
    try:
        source = pq.ParquetFile(pa.BufferReader(MAGIC + tail))
        metadata, schema = source.metadata, source.schema_arrow
        groups = read_groups(tail, size)
    except (OSError, ValueError, pa.ArrowException, DamageError) as error:
        raise LogError(f"{path}: damaged footer ({reason_of(error)})", "PQ001") from error
    return Footer(size, metadata, present_columns(str(path), kind, schema), groups)


def read_groups(tail: bytes, size: int) -> list[Group]:
    """Return the row groups that the end of a file of `size` bytes describes. Raises DamageError where one isn't all
    there.
    """
    return [
        Group(get(group, _GROUP_ROWS, int), [_chunk(c, size - len(tail)) for c in get(group, _COLUMNS, list)])
        for group in get(read_struct(memoryview(tail))[0], _ROW_GROUPS, list)
    ]


def require_parsable(path: Path, tail: bytes) -> None:
    """Refuse a footer that would take too much memory when it is parsed. Raises LimitError where it would."""
    if tail.count(0) > MAX_ZEROS:
        raise LimitError(f"{path}: its footer is too large to be read safely; write larger row groups", "LIM004")


def read_tail(path: Path, file: BinaryIO, size: int) -> bytes:
    """Return everything after the last row group. Raises LogError where the file is cut off, damaged or no Parquet."""
    start, end = os.pread(file.fileno(), 4, 0), os.pread(file.fileno(), _END, max(0, size - _END))
    if size < len(MAGIC) + _END or start != MAGIC or end[4:] != MAGIC:
        state = "its start or end is damaged, or it is truncated" if MAGIC in (start, end[4:]) else "not Parquet"
        raise LogError(f"{path}: {state} (looks like {looks_like(file)})", "PQ001")
    length = int.from_bytes(end[:4], "little") + _END
    if length > min(_MAX_FOOTER, size - len(MAGIC)):
        raise LogError(f"{path}: damaged, its footer claims {length} bytes", "PQ001")
    return os.pread(file.fileno(), length, size - length)


def reason_of(error: Exception) -> str:
    """First line of a library's error."""
    return (str(error).splitlines() or [type(error).__name__])[0]
