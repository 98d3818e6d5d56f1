"""What a file defines outside its chunks and messages, within bounds: schemas, channels and fbench's own metadata."""

from mcap.records import Metadata

from fbench.replay.errors import LimitError
from fbench.replay.logs import header
from fbench.replay.logs.mcap.records import RecordError, parse_record

MAX_DEFINITIONS = 16 * 1024 * 1024
"""Schemas and channels of a file that take more together are refused: parsed, channels take many times as much."""
MAX_METADATA = 4 * 1024 * 1024
MAX_CHUNKS = 2**19
"""Each takes hundreds of bytes in the index of a file; with chunks of the usual size that is half a terabyte."""
_OWN = len(header.NAME).to_bytes(4, "little") + header.NAME.encode()


def check_definitions(where: str, size: int) -> None:
    """Refuse schemas and channels that are larger than `MAX_DEFINITIONS`.

    Raises:
        LimitError: naming the place.
    """
    if size > MAX_DEFINITIONS:
        raise LimitError(f"{where}: schemas and channels of more than {MAX_DEFINITIONS} bytes", "LIM001")


def check_chunks(where: str, num: int) -> None:
    """Refuse more than `MAX_CHUNKS` chunks.

    Raises:
        LimitError: naming the file.
    """
    if num > MAX_CHUNKS:
        raise LimitError(f"{where}: more than {MAX_CHUNKS} chunks; write larger ones", "LIM001")


def own_metadata(content: bytes) -> Metadata | None:
    """Parse a metadata record of fbench; those of others aren't used.

    Raises:
        RecordError: where it is damaged or too large.
    """
    if not content.startswith(_OWN):
        return None
    if len(content) > MAX_METADATA:
        raise RecordError(f"metadata of {len(content)} bytes, more than the limit of {MAX_METADATA}")
    record: Metadata = parse_record(Metadata.read, content)
    return record
