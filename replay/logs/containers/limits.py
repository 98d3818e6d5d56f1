"""Checksums, memory bounds, seeking and the recognition of files that containers share."""

from collections.abc import Iterable, Iterator
from typing import BinaryIO, Protocol, runtime_checkable

from isal.isal_zlib import crc32

from fbench.replay.contracts.errors import LimitError
from fbench.replay.logs.container import Container, Entry

_MAGICS = (
    (b"PAR1", "Parquet; give the folder that it belongs to"),
    (b"\x1f\x8b", "gzip"),
    (b"PK\x03\x04", "a zip archive"),
    (b"\x28\xb5\x2f\xfd", "zstd; decompress it first"),
    (b"\x04\x22\x4d\x18", "lz4; decompress it first"),
    (b"\x89HDF\r\n", "HDF5"),
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"\x89MCAP", "MCAP of another version"),
)


def looks_like(file: BinaryIO) -> str:
    """Guess what a file is."""
    file.seek(0)
    start = file.read(512)
    if not start:
        return "an empty file"
    known = next((name for magic, name in _MAGICS if start.startswith(magic)), None)
    if known is not None:
        return known
    if not _is_text(start):
        return "unknown binary data"
    return "JSON" if start.lstrip()[:1] in (b"{", b"[") else "text"


def _is_text(start: bytes) -> bool:
    try:
        text = start[: start.rfind(b"\n") + 1 or None].decode()
    except UnicodeDecodeError:
        return False
    return all(c.isprintable() or c.isspace() for c in text)


@runtime_checkable
class Seekable(Protocol):
    """A container that needn't read what comes before."""

    def entries_from(self, channels: frozenset[int], start_ns: int) -> Iterator[Entry]:
        """All messages of these channels from a log time on, in canonical order."""
        ...


def entries_from(container: Container, channels: frozenset[int], start_ns: int) -> Iterator[Entry]:
    """Return all messages of these channels from a log time on, in canonical order, however they are found."""
    if isinstance(container, Seekable):
        return container.entries_from(channels, start_ns)
    return (entry for entry in container.entries(channels) if entry.log_ns >= start_ns)


MAX_HELD = 256 * 1024 * 1024  # Blocks that overlap in time are in memory together; so much they may always take [byte]
MAX_RATIO = 32  # Beyond that they may take so many times what they take in the file: real data don't compress better
_ENTRY = 400  # What telling a message apart takes [byte]


class Held:
    """Counts what the blocks that are in use take."""

    def __init__(self) -> None:
        self._size, self._stored = 0, 0

    def require(self, where: str, size: int, stored: int) -> None:
        """Refuse a block before it is unpacked.

        Args:
            where: Its place, for the error.
            size: What it takes in memory [byte].
            stored: What it takes in the file [byte].

        Raises:
            LimitError: where it and those in use would be too much; one alone is never refused.
        """
        if self._size and self._size + size > max(MAX_HELD, MAX_RATIO * (self._stored + stored)):
            what = f"chunks that overlap in time unpack to over {MAX_HELD} bytes, {MAX_RATIO} times what they are"
            raise LimitError(f"{where}: {what}; it is a decompression bomb", "LIM002")

    def hold(self, entries: Iterable[Entry], num: int, size: int, stored: int) -> Iterator[Entry]:
        """Yield the `num` messages of a block, which is in use until the last one is taken."""
        size += _ENTRY * num
        self._size, self._stored = self._size + size, self._stored + stored
        yield from entries
        self._size, self._stored = self._size - size, self._stored - stored


__all__ = ["crc32"]
