"""The base of containers that are files or folders, and the checksums, memory bounds and guesses that they share."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from isal.isal_zlib import crc32

from fbench.replay.contracts.errors import LimitError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import Message, Truth
from fbench.replay.data.rig import Rig
from fbench.replay.logs.container import Entry, LogHeader

__all__ = ["crc32"]

MAX_STAMP_NS, MAX_FRAME_NUMBER = 2**63 - 1, 2**32 - 1
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
    (b"version https://git-lfs", "a pointer of Git LFS; get the file with `git lfs pull`"),
)


def looks_like(file: BinaryIO) -> str:
    """Guess what a file is."""
    file.seek(0)
    start = file.read(512)
    if not start:
        return "an empty file"
    for magic, name in _MAGICS:
        if start.startswith(magic):
            return name
    with suppress(UnicodeDecodeError):
        if all(c.isprintable() or c.isspace() for c in start[: start.rfind(b"\n") + 1 or None].decode()):
            return "JSON" if start.lstrip()[:1] in (b"{", b"[") else "text"
    return "unknown binary data"


def check_storable(path: Path, message: Message | Truth) -> str:
    """Return the place of a message, for errors. Raises LogError where a log can't hold a stamp or its frame number."""
    where = f"{path}: {type(message).__name__} at {message.stamp_ns}"
    for name, limit in (("stamp_ns", MAX_STAMP_NS), ("log_ns", MAX_STAMP_NS), ("frame_number", MAX_FRAME_NUMBER)):
        value = getattr(message, name) or 0
        if not 0 <= value <= limit:
            raise LogError(f"{where}: {name} {value} is outside 0 to {limit}")
    return where


class StoredLog:
    """The part of `Container` that is alike in all that are stored as one file or folder; by itself, one of others."""

    header: LogHeader | None = None
    keeps_checksums = True
    rigs: Sequence[tuple[int, Rig]] = ()  # Messages tell the rig

    def __init__(self, path: Path, faults: FaultLog) -> None:
        self.path, self._faults = path, faults

    def verify(self) -> None:
        """There is nothing to compare that reading didn't: no other checksums."""

    def once(self, code: str, key: tuple[str | int, ...], where: str) -> None:
        """Count a fault unless `key`, the place, was counted under the same code before."""
        self._faults.once(code, (str(self.path), *key), f"{self.path.name}: {where}")

    @contextmanager
    def _open(self) -> Iterator[BinaryIO]:
        try:
            with self.path.open("rb") as file:
                yield file
        except OSError as error:
            raise LogError(f"{self.path}: can't be read ({error.strerror})") from error


MAX_HELD = 256 * 1024 * 1024  # Blocks that overlap in time are in memory together; so much they may always take [byte]
MAX_RATIO = 32  # Beyond that they may take so many times what they take in the file: real data don't compress better
_ENTRY = 400  # What telling a message apart takes [byte]


class Held:
    """Counts what the blocks that are in use take."""

    _size = _stored = 0

    def require(self, where: str, size: int, stored: int) -> None:
        """Refuse a block before it is unpacked, which takes `size` bytes in memory and `stored` in the file. Raises
        LimitError naming its place, `where`, where it and those in use would be too much; one alone is never refused.
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
