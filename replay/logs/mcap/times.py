"""Log times of all messages from the message indexes behind the chunks, without reading the chunks.

https://mcap.dev/spec#message-index-op0x07: channel, length of an array, and in it log time and offset of each message.
No checksum covers them, so they count only where they agree with the index of the file, which one covers.
"""

import os
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from mcap.opcode import Opcode

from fbench.replay.arrays import Array, Int64
from fbench.replay.errors import LimitError
from fbench.replay.logs.mcap.index import Block, Index
from fbench.replay.logs.mcap.records import HEAD, RecordError, records

MAX_SHARE = 0.005
"""Message indexes that are a larger share of the file aren't read, unless they are small:"""
SMALL = 1024 * 1024
"""[byte]."""
_ARRAY = struct.Struct("<HI")
_WHERE = "message indexes"
_ENTRY = np.dtype([("log_ns", "<u8"), ("offset", "<u8")])


class _MismatchError(Exception):
    """The message indexes can't be trusted."""


@dataclass
class _Stream:
    """The entries of one channel, and whose chunks they are."""

    data: bytearray = field(default_factory=bytearray)
    blocks: list[int] = field(default_factory=list)
    nums: list[int] = field(default_factory=list)


def read_log_times(file: int, size: int, index: Index) -> Mapping[int, Int64] | None:
    """Log times of each channel's messages, ascending; `None` where the indexes are absent, too large or wrong.

    Args:
        file: Descriptor of the open file.
        size: Of the file [byte].
        index: As the file's summary says.
    """
    lengths = [block.index_length for block in index.blocks]
    if not index.is_stored or sum(lengths) > max(MAX_SHARE * size, SMALL):
        return None
    try:
        return _checked(_read(file, index.blocks), index)
    except (_MismatchError, RecordError, LimitError):
        return None


def _read(file: int, blocks: Sequence[Block]) -> dict[int, _Stream]:
    streams: dict[int, _Stream] = {}
    for number, block in enumerate(blocks):
        # Not through a buffer, which would read more than what is wanted.
        data = memoryview(os.pread(file, block.index_length, block.offset + block.length))
        if len(data) != block.index_length:
            raise _MismatchError
        found = [_add(streams, number, opcode, data[start:stop]) for opcode, start, stop in records(data, _WHERE)]
        if sorted(found) != sorted(block.channels or ()):
            raise _MismatchError
    return streams


def _add(streams: dict[int, _Stream], block: int, opcode: int, content: memoryview) -> int:
    """Take one record; returns its channel."""
    if opcode != Opcode.MESSAGE_INDEX or len(content) < _ARRAY.size:
        raise _MismatchError
    channel, length = _ARRAY.unpack_from(content)
    if length != len(content) - _ARRAY.size or length % _ENTRY.itemsize:
        raise _MismatchError
    stream = streams.setdefault(channel, _Stream())
    stream.data += content[_ARRAY.size :]
    stream.blocks.append(block)
    stream.nums.append(length // _ENTRY.itemsize)
    return int(channel)


def _checked(streams: Mapping[int, _Stream], index: Index) -> dict[int, Int64]:
    if {id_: sum(s.nums) for id_, s in streams.items()} != {id_: n for id_, n in index.counts.items() if n}:
        raise _MismatchError
    bounds = np.array([(b.start_ns, b.end_ns, b.size or 0) for b in index.blocks], np.uint64).reshape(-1, 3)
    return {id_: _times(stream, bounds) for id_, stream in sorted(streams.items())}


def _times(stream: _Stream, bounds: Array) -> Int64:
    entries = np.frombuffer(bytes(stream.data), _ENTRY)
    start, end, size = bounds[np.repeat(stream.blocks, stream.nums)].T
    log_ns = entries["log_ns"]
    if not np.all((start <= log_ns) & (log_ns <= end) & (entries["offset"] + HEAD.size <= size)):
        raise _MismatchError
    if len(log_ns) and int(log_ns.max()) > np.iinfo(np.int64).max:
        raise _MismatchError
    return np.sort(log_ns.astype(np.int64), kind="stable")
