"""MCAP on the level of records: framing, parsing, and chunks unpacked within bounds.

https://mcap.dev/spec: a record is an opcode (1 byte), the length of its content (8 bytes, little endian), the content.
"""

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO, NamedTuple, Protocol, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError

from fbench.replay.errors import LogError

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
MAX_RECORD = 256 * 1024 * 1024
"""Larger records and chunks, stored or unpacked, are refused before memory is allocated."""
_CHUNK = struct.Struct("<QQQI")
_UINT64 = struct.Struct("<Q")
_UINT32 = struct.Struct("<I")
COMPRESSIONS = ("", "zstd", "lz4")


class RecordError(LogError):
    """A record or chunk that is damaged; readers count it and go on."""


class Chunk(NamedTuple):
    """A chunk record."""

    start_ns: int
    end_ns: int
    size: int
    """When unpacked [byte]."""
    crc: int
    """CRC-32 of the unpacked content; 0: absent."""
    compression: str
    data: memoryview


R_co = TypeVar("R_co", covariant=True)


class _Readable(Protocol[R_co]):
    def __call__(self, stream: ReadDataStream) -> R_co: ...


def parse_record(read: _Readable[R_co], content: bytes) -> R_co:
    """Parse the content of one record with the `read` of its class in `mcap.records`.

    Raises:
        RecordError: where the content is damaged.
    """
    stream = ReadDataStream(BytesIO(content))
    try:
        record = read(stream)
    except (McapError, struct.error, UnicodeDecodeError, OverflowError, MemoryError) as error:
        raise RecordError(f"record can't be read ({error or type(error).__name__})") from error
    if stream.count != len(content):
        raise RecordError(f"record of {len(content)} bytes ends after {stream.count}")
    return record


def read_head(file: BinaryIO, offset: int) -> tuple[int, int] | None:
    """Opcode and content length of the record at `offset`; `None` where the file ends before."""
    file.seek(offset)
    head = file.read(HEAD.size)
    return HEAD.unpack(head) if len(head) == HEAD.size else None


def check_size(where: str, size: int) -> None:
    """Refuse what is larger than `MAX_RECORD`.

    Raises:
        LogError: naming the place.
    """
    if size > MAX_RECORD:
        raise LogError(f"{where}: declares {size} bytes, more than the limit of {MAX_RECORD}")


def parse_chunk(content: memoryview) -> Chunk:
    """Parse the content of a chunk record.

    Raises:
        RecordError: where its lengths don't fit together.
    """
    try:
        start_ns, end_ns, size, crc = _CHUNK.unpack_from(content)
        at = _CHUNK.size
        (length,) = _UINT32.unpack_from(content, at)
        name = bytes(content[at + 4 : at + 4 + length])
        at += 4 + length
        (stored,) = _UINT64.unpack_from(content, at)
        compression = name.decode()
    except (struct.error, UnicodeDecodeError) as error:
        raise RecordError(f"chunk header can't be read ({error})") from error
    data = content[at + 8 :]
    if len(data) != stored:
        raise RecordError(f"chunk declares {stored} bytes and has {len(data)}")
    return Chunk(start_ns, end_ns, size, crc, compression, data)


def unpack(chunk: Chunk) -> memoryview:
    """Decompress a chunk and check size and, where there is one, checksum.

    Never allocates more than the declared size, which the caller has checked.

    Raises:
        RecordError: where the content is damaged or of another size.
    """
    data = chunk.data if chunk.compression == "" else memoryview(_decompress(chunk))
    if len(data) != chunk.size:
        raise RecordError(f"chunk declares {chunk.size} unpacked bytes and has {_at_least(len(data), chunk.size)}")
    if chunk.crc and zlib.crc32(data) != chunk.crc:
        raise RecordError("checksum doesn't match")
    return data


def _at_least(size: int, limit: int) -> str:
    return f"{size}" if size < limit else f"more than {limit}"


def _decompress(chunk: Chunk) -> bytes:
    """Decompress up to one byte beyond the declared size: enough to see that there is more."""
    try:
        if chunk.compression == "zstd":
            with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
                return reader.read(chunk.size + 1)
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=chunk.size + 1))
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise RecordError(f"{chunk.compression} data are damaged ({error})") from error


def records(buffer: memoryview) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and stop of the content of each record in a buffer.

    Raises:
        RecordError: where a record reaches beyond the buffer.
    """
    at = 0
    while at < len(buffer):
        if at + HEAD.size > len(buffer):
            raise RecordError(f"record at byte {at} of the chunk is cut off")
        opcode, length = HEAD.unpack_from(buffer, at)
        at += HEAD.size
        if length > len(buffer) - at:
            raise RecordError(f"record at byte {at - HEAD.size} of the chunk is longer than the chunk")
        yield opcode, at, at + length
        at += length
