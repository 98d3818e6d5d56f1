"""How much of a log that is unpacked may be in memory at once."""

from collections.abc import Iterable, Iterator

from fbench.replay.errors import LimitError
from fbench.replay.logs.container import Entry

MAX_HELD = 256 * 1024 * 1024
"""Blocks that overlap in time are in memory together; so much they may always take [byte]."""
MAX_RATIO = 32
"""Beyond that they may take so many times what they take in the file: real data don't compress better."""
_ENTRY = 400
"""What telling a message apart takes [byte]."""


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
