"""Files of a log, and bytes in memory that look like parts of a file."""

import errno
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, NamedTuple

from fbench.replay.contracts.errors import LogError

# A FIFO would block, and a link could lead anywhere.
_FLAGS = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
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


def check_path(folder: Path, name: str) -> Path:
    """Return the path of a file of the log. Raises LogError where the name isn't that of a file in the log's own
    folder.
    """
    if name in ("", ".", "..") or any(c in name for c in "/\\\0"):
        raise LogError(f"{folder}: stream in file {name!r}: not a plain file name", "SEC002")
    return folder / name


class Piece(NamedTuple):
    """Consecutive bytes of a file."""

    offset: int
    data: memoryview


class Pieces:
    """Bytes that were read and verified, as the file that pyarrow wants; there is nothing between the pieces."""

    def __init__(self, pieces: Sequence[Piece], size: int) -> None:
        self._pieces, self._size, self._at = pieces, size, 0
        self.closed = False

    def seek(self, at: int, whence: int = 0) -> int:
        """Move as in files."""
        self._at = at + (0, self._at, self._size)[whence]
        return self._at

    def tell(self) -> int:
        """Position as in files."""
        return self._at

    def read(self, length: int = -1) -> memoryview:
        """Return the bytes of one piece, without a copy; nothing where there is none."""
        for offset, data in self._pieces:
            if offset <= self._at < offset + len(data):
                found = data[self._at - offset :][: length if length >= 0 else None]
                self._at += len(found)
                return found
        return memoryview(b"")

    def readable(self) -> bool:
        """As files."""
        return True

    def seekable(self) -> bool:
        """As files."""
        return True

    def close(self) -> None:
        """As files."""
        self.closed = True
