"""MCAP on the level of records: framing, parsing, and chunks unpacked within bounds.

https://mcap.dev/spec: a record is an opcode (1 byte), the length of its content (8 bytes, little endian), the content.
"""

import struct
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import BinaryIO, NamedTuple, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError

from fbench.replay.contracts.errors import LimitError, LogError
from fbench.replay.logs.containers.limits import crc32

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
MESSAGE = struct.Struct("<HIQQ")  # Channel, sequence, log time and publish time at the start of a message record
_CHUNK = struct.Struct("<QQQI")
_UINT64 = struct.Struct("<Q")
_UINT32 = struct.Struct("<I")
MAX_RECORD = 256 * 1024 * 1024  # Larger records and chunks, stored or unpacked, are refused before memory is allocated
MAX_RECORDS = 2**20
"""A chunk or summary of more records is refused: each takes time, and empty ones compress to almost nothing."""
_UNKNOWN_SIZE = -1
_PIECE = 1024 * 1024
_SLACK = 16 * _PIECE  # A chunk that unpacks to so much more than it declares isn't damaged but made to fill the memory
R = TypeVar("R")


class RecordError(LogError):
    """A record or chunk that is damaged; readers count it and go on."""


class Chunk(NamedTuple):
    """A chunk record."""

    start_ns: int
    end_ns: int
    size: int  # When unpacked [byte]
    crc: int  # CRC-32 of the unpacked content; 0: absent
    compression: str
    data: memoryview


class _Lenient(ReadDataStream):
    """Keeps the bytes of a text that isn't UTF-8 as lone surrogates, so that one bad name doesn't cost a topic."""

    def read_prefixed_string(self) -> str:
        return self.read(self.read4()).decode(errors="surrogateescape")


def parse_record(read: Callable[[ReadDataStream], R], content: bytes) -> R:
    """Parse the content of one record with the `read` of its class in `mcap.records`. Raises RecordError where the
    content is damaged.
    """
    stream = _Lenient(BytesIO(content))
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
    """Refuse what is larger than `MAX_RECORD`. Raises LimitError naming the place."""
    if size > MAX_RECORD:
        raise LimitError(f"{where}: declares {size} bytes, more than the limit of {MAX_RECORD}", "LIM001")


def parse_chunk(content: memoryview) -> Chunk:
    """Parse the content of a chunk record. Raises RecordError where its lengths don't fit together."""
    try:
        start_ns, end_ns, size, crc = _CHUNK.unpack_from(content)
        (length,) = _UINT32.unpack_from(content, _CHUNK.size)
        at = _CHUNK.size + 4 + length
        (stored,) = _UINT64.unpack_from(content, at)
        compression = bytes(content[at - length : at]).decode()
    except (struct.error, UnicodeDecodeError) as error:
        raise RecordError(f"chunk header can't be read ({error})") from error
    data = content[at + 8 :]
    if len(data) != stored:
        raise RecordError(f"chunk declares {stored} bytes and has {len(data)}")
    return Chunk(start_ns, end_ns, size, crc, compression, data)


def check_chunk(chunk: Chunk, where: str) -> None:
    """Refuse what can't be unpacked. Raises LimitError where it is too large. Raises LogError naming the place and the
    compression.
    """
    check_size(where, chunk.size)
    if chunk.compression not in ("", "zstd", "lz4"):
        raise LogError(f"{where}: unknown compression '{chunk.compression}'; fbench reads zstd, lz4 and none", "LOG007")


def unpack(chunk: Chunk, where: str) -> memoryview:
    """Decompress a chunk and check size and, where there is one, checksum.

    Never allocates much more than the declared size, which the caller has checked. Raises RecordError where the content
    is damaged, or says itself or shows that it is of another size. Raises LimitError where it is so much larger that it
    can't be damage; names the place, `where`.
    """
    data = chunk.data
    try:
        if chunk.compression == "zstd":
            data = _unpack_zstd(chunk, where)
        elif chunk.compression:
            unpacker, rest = lz4.frame.LZ4FrameDecompressor(), iter([chunk.data])
            data = _read(chunk, lambda most: unpacker.decompress(next(rest, b""), max_length=most), where)
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise RecordError(f"{chunk.compression} data are damaged ({error})") from error
    if len(data) != chunk.size:
        more = "" if len(data) < chunk.size else "more than "
        raise RecordError(f"chunk declares {chunk.size} unpacked bytes and has {more}{min(len(data), chunk.size)}")
    if chunk.crc and crc32(data) != chunk.crc:
        raise RecordError("checksum doesn't match")
    return data


def _unpack_zstd(chunk: Chunk, where: str) -> memoryview:
    """What the frame says of its size is checked before memory of that size is taken."""
    size = zstandard.frame_content_size(chunk.data)
    if size == _UNKNOWN_SIZE:
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            return _read(chunk, reader.read, where)
    if size > chunk.size + _SLACK:
        raise _bomb(chunk, where)
    if size != chunk.size:
        raise RecordError(f"chunk declares {chunk.size} unpacked bytes and has {size}")
    unpacker = zstandard.ZstdDecompressor()
    return memoryview(unpacker.decompress(chunk.data, max_output_size=chunk.size, allow_extra_data=False))


def _read(chunk: Chunk, read: Callable[[int], bytes], where: str) -> memoryview:
    """Read one byte beyond the declared size: enough to see that there is more, and then how much more. Pieces keep
    the libraries from holding all of it a second time.
    """
    data = bytearray()
    while len(data) <= chunk.size and (piece := read(min(_PIECE, chunk.size + 1 - len(data)))):
        data += piece
    excess = max(0, len(data) - chunk.size)
    while excess and (piece := read(_PIECE)):
        excess += len(piece)
        if excess > _SLACK:
            raise _bomb(chunk, where)
    return memoryview(data)


def _bomb(chunk: Chunk, where: str) -> LimitError:
    size, stored = chunk.size, len(chunk.data)
    what = f"{chunk.compression} chunk of {stored} bytes declares {size} unpacked bytes and has over {size + _SLACK}"
    return LimitError(f"{where}: {what}; it is a decompression bomb", "LIM002")


def split(buffer: memoryview, where: str) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and stop of the content of each record in a buffer. Raises RecordError where a record reaches
    beyond the buffer. Raises LimitError where there are more than `MAX_RECORDS`; names the place, `where`.
    """
    at = 0
    for _ in range(MAX_RECORDS):
        if at == len(buffer):
            return
        if at + HEAD.size > len(buffer):
            raise RecordError(f"record at byte {at} of the chunk is cut off")
        opcode, length = HEAD.unpack_from(buffer, at)
        at += HEAD.size
        if length > len(buffer) - at:
            raise RecordError(f"record at byte {at - HEAD.size} of the chunk is longer than the chunk")
        yield opcode, at, at + length
        at += length
    if at < len(buffer):
        raise LimitError(f"{where}: holds more than {MAX_RECORDS} records", "LIM001")
