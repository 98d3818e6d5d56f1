"""ROS 1 bags on the level of records: framing, fields of headers, and chunks unpacked within bounds.

http://wiki.ros.org/Bags/Format/2.0: a record is the length of its header (4 bytes, little endian), the header, the
length of its data (4 bytes), the data; a header is a row of fields, each its length (4 bytes) and `name=value`.
"""

import bz2
from collections.abc import Iterator, Mapping
from enum import IntEnum
from typing import Any, BinaryIO, NamedTuple

import lz4.frame

from fbench.replay.logs.container import Channel, Schema
from fbench.replay.logs.containers.mcap.records import RecordError, check_size

Fields = Mapping[bytes, bytes]
_PIECE = 4 * 1024 * 1024
_MAX_FIELDS = 64


class Op(IntEnum):
    """Types of records."""

    MESSAGE = 2
    BAG_HEADER = 3
    INDEX_DATA = 4
    CHUNK = 5
    CHUNK_INFO = 6
    CONNECTION = 7


class Record(NamedTuple):
    """A record: its place and that of its data, and the fields of its header."""

    start: int
    fields: Fields
    data: int
    stop: int

    @property
    def op(self) -> int:
        """Its type. Raises RecordError where it has none."""
        return self.uint(b"op", 1)

    def uint(self, name: bytes, num_bytes: int = 4) -> int:
        """Return the unsigned number in a field. Raises RecordError where it is missing or of another length."""
        value = self.fields.get(name, b"")
        if len(value) != num_bytes:
            raise RecordError(f"record has no field '{name.decode()}' of {num_bytes} bytes")
        return int.from_bytes(value, "little")

    def time_ns(self, name: bytes) -> int:
        """Return the time in a field [ns]. Raises RecordError where it is missing or of another length."""
        nanoseconds, seconds = divmod(self.uint(name, 8), 2**32)
        return seconds * 1_000_000_000 + nanoseconds


def records(buffer: memoryview) -> Iterator[Record]:
    """Yield the records of a buffer. Raises RecordError where one is damaged or reaches beyond the buffer."""
    at = 0
    while at < len(buffer):
        data = at + 8 + _uint32(buffer, at)
        stop = data + _uint32(buffer, data - 4)
        if stop > len(buffer):
            raise RecordError(f"record at its byte {at} is cut off")
        yield Record(at, parse_fields(buffer[at + 4 : data - 4]), data, stop)
        at = stop


def _uint32(buffer: memoryview, at: int) -> int:
    if at + 4 > len(buffer):
        raise RecordError(f"record is cut off at its byte {at}")
    return int.from_bytes(buffer[at : at + 4], "little")


def read_record(file: BinaryIO, at: int, size: int) -> Record | None:
    """Read the head of the record at `at` in a file of `size` bytes; `None` where the file ends before the record does.
    Raises RecordError where its header is damaged. Raises LogError where the header is larger than the limit.
    """
    header = _read_length(file, at, size)
    if header is None:
        return None
    check_size(f"record at byte {at}", header)
    content = file.read(header)
    data = at + 8 + header
    length = _read_length(file, data - 4, size)
    return None if length is None else Record(at, parse_fields(memoryview(content)), data, data + length)


def _read_length(file: BinaryIO, at: int, size: int) -> int | None:
    """The length at `at`; `None` where the file ends before what it is the length of."""
    file.seek(at)
    head = file.read(4)
    length = int.from_bytes(head, "little")
    return length if len(head) == 4 and length <= size - at - 4 else None


def parse_fields(header: memoryview) -> Fields:
    """Parse the fields of a header. Raises RecordError where they don't fill it."""
    fields: dict[bytes, bytes] = {}
    at = 0
    while at < len(header):
        length = _uint32(header, at)
        field = bytes(header[at + 4 : at + 4 + length])
        name, sign, value = field.partition(b"=")
        if len(field) != length or not sign:
            raise RecordError("header of a record is damaged")
        if name in fields or len(fields) == _MAX_FIELDS:
            raise RecordError(f"header of a record has a field twice, or more than {_MAX_FIELDS}")
        fields[name] = value
        at += 4 + length
    return fields


def connection(record: Record, data: memoryview) -> tuple[int, Channel]:
    """Parse a connection record and its data: its id, and the channel it is; what isn't UTF-8 in names is escaped.
    Raises RecordError where it is damaged.
    """
    details = parse_fields(data)
    if b"topic" not in record.fields or b"type" not in details:
        raise RecordError("connection has no topic or type")
    schema = Schema(_text(details[b"type"]), "ros1msg", details.get(b"message_definition", b""))
    more = {key.decode(): _text(details[key]) for key in (b"callerid", b"latching", b"md5sum") if key in details}
    return record.uint(b"conn"), Channel(_text(record.fields[b"topic"]), "ros1", schema, more)


def _text(value: bytes) -> str:
    return value.decode("utf-8", "backslashreplace")


def unpack(compression: str, data: memoryview, size: int) -> memoryview:
    """Decompress a chunk of `size` unpacked bytes, which the caller has checked; never allocates more. Raises
    RecordError where the content is damaged or of another size.
    """
    if compression == "none":
        if len(data) != size:
            raise RecordError(f"chunk declares {size} bytes and has {len(data)}")
        return data
    unpacker: Any = bz2.BZ2Decompressor() if compression == "bz2" else lz4.frame.LZ4FrameDecompressor()
    at, packed = 0, data
    try:
        buffer = bytearray(size)
        while not unpacker.eof and (piece := unpacker.decompress(packed, _PIECE)):
            if at + len(piece) > size:
                raise RecordError(f"chunk declares {size} unpacked bytes and has more")
            buffer[at : at + len(piece)] = piece
            at, packed = at + len(piece), memoryview(b"")
    except (OSError, RuntimeError, EOFError, ValueError, MemoryError) as error:
        raise RecordError(f"{compression} data are damaged ({error})") from error
    if at != size or not unpacker.eof:
        raise RecordError(f"chunk declares {size} unpacked bytes and has {at}")
    return memoryview(buffer)
