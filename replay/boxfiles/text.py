"""Reading files of lines."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from fbench.replay.errors import LimitError, LogError

_MAX_LINE = 100_000
_MAX_LINES = 5_000_000
MAX_FRAMES = 10_000_000
"""Files that count more frames than this are refused."""


@dataclass(frozen=True, slots=True)
class Line:
    """One line that isn't empty."""

    path: Path
    number: int
    """The file's first line is 1."""
    fields: list[str]

    @property
    def where(self) -> str:
        """For errors."""
        return f"{self.path} line {self.number}"


def lines(path: Path, separator: str | None = None) -> Iterator[Line]:
    """Yield the lines of a text, split at blanks or at a separator; a byte order mark and blank lines are no matter.

    Raises:
        LogError: where the file can't be read, or is no text.
        LimitError: where a line has no end.
    """
    try:
        with path.open(encoding="utf-8-sig") as file:
            for number, text in enumerate(iter(lambda: file.readline(_MAX_LINE), ""), 1):
                if len(text) >= _MAX_LINE:
                    raise LimitError(f"{path} line {number}: longer than {_MAX_LINE} characters")
                if number > _MAX_LINES:
                    raise LimitError(f"{path}: more than {_MAX_LINES} lines; split it, or use Parquet")
                fields = [field.strip() for field in text.strip().split(separator)] if text.strip() else []
                if fields:
                    yield Line(path, number, fields)
    except UnicodeDecodeError as error:
        raise LogError(f"{path}: isn't UTF-8 text ({error.reason} at byte {error.start})") from error
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error


def frame_number(text: str, where: str) -> int:
    """Return the number of a frame.

    Raises:
        LogError: where it is none.
        LimitError: where it is beyond all reason.
    """
    try:
        number = int(text[:40])
    except ValueError:
        raise LogError(f"{where}: frame is '{text[:40]}', expected a whole number") from None
    if not 0 <= number < MAX_FRAMES:
        raise LimitError(f"{where}: frame is {number}, expected 0 to {MAX_FRAMES - 1}")
    return number
