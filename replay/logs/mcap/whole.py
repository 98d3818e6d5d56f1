"""The checksum over the whole data section of an MCAP file."""

from struct import Struct
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import DataEnd

from fbench.replay.checksums import crc32
from fbench.replay.logs.mcap.records import HEAD, MAGIC, RecordError, parse_record

_PIECE = 8 * 1024 * 1024
_END = HEAD.size + 4
_FOOTER = Struct("<Q12x")
"""Content of the footer: where the summary starts, and what isn't needed here."""


def is_whole(file: BinaryIO, size: int) -> bool | None:
    """Compare all bytes before the record DataEnd, which lies right before the summary, with the checksum in it.

    Args:
        file: With a summary.
        size: Of the file [byte].

    Returns:
        `None` where there is none.
    """
    file.seek(size - len(MAGIC) - _FOOTER.size)
    (summary_start,) = _FOOTER.unpack(file.read(_FOOTER.size))
    at = summary_start - _END
    file.seek(max(0, at))
    end = file.read(_END)
    if at < 0 or HEAD.unpack_from(end) != (Opcode.DATA_END, 4):
        return None
    try:
        stored = parse_record(DataEnd.read, end[HEAD.size :]).data_section_crc
    except RecordError:
        return None
    if stored == 0:
        return None
    file.seek(0)
    crc, left = 0, at
    while left and (piece := file.read(min(_PIECE, left))):
        crc, left = crc32(piece, crc), left - len(piece)
    return bool(crc == stored)
