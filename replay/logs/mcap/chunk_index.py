"""Chunk index records, of which a large file has tens of thousands: parsed at once, not field by field."""

import struct
from typing import NamedTuple

from fbench.replay.logs.mcap.records import RecordError

_TIMES = struct.Struct("<QQQQI")
_OFFSET = struct.Struct("<HQ")
_LENGTHS = struct.Struct("<QI")
_SIZES = struct.Struct("<QQ")
_MAX_OFFSETS = 2**16 * _OFFSET.size
"""One for each channel."""


class ChunkIndex(NamedTuple):
    """Where a chunk is and what it holds."""

    start_ns: int
    end_ns: int
    offset: int
    """Of the chunk record in the file, with its length [byte]."""
    length: int
    channels: frozenset[int]
    """Those that have a message index behind the chunk."""
    index_length: int
    """Of all its message indexes [byte]."""
    compression: str
    stored: int
    """Size of the content, compressed and not [byte]."""
    size: int


def parse_chunk_index(content: memoryview) -> ChunkIndex:
    """Parse the content of a chunk index record.

    Raises:
        RecordError: where its lengths don't fit together.
    """
    try:
        start_ns, end_ns, offset, length, num_bytes = _TIMES.unpack_from(content)
        if num_bytes > _MAX_OFFSETS:
            raise RecordError(f"chunk index has {num_bytes} bytes of offsets")
        at = _TIMES.size + num_bytes
        channels = frozenset(id_ for id_, _ in _OFFSET.iter_unpack(content[_TIMES.size : at]))
        index_length, num_text = _LENGTHS.unpack_from(content, at)
        at += _LENGTHS.size + num_text
        compression = str(content[at - num_text : at], "utf-8")
        stored, size = _SIZES.unpack_from(content, at)
    except (struct.error, UnicodeDecodeError) as error:
        raise RecordError(f"chunk index can't be read ({error})") from error
    if at + _SIZES.size != len(content):
        raise RecordError(f"chunk index of {len(content)} bytes ends after {at + _SIZES.size}")
    return ChunkIndex(start_ns, end_ns, offset, length, channels, index_length, compression, stored, size)
