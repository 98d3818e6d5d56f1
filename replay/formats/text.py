"""Read text files line by line: numbers, ids, frames and stamps, with errors that name the place."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from hashlib import blake2b
from pathlib import Path

import numpy as np

from fbench.replay.contracts.errors import LimitError, LogError

_MAX_LINE = 100_000
_MAX_LINES = 5_000_000
MAX_FRAMES = 10_000_000  # Files that count more frames than this are refused
_MAX_NS = 2**63 - 1
_MAX_S = Decimal(_MAX_NS // 10**9 + 1)
_TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d(:\d\d(\.\d+)?)?", re.ASCII)  # numpy takes more, and warns of some
_ZONE = re.compile(r"([+-])(\d\d):?(\d\d)$", re.ASCII)
_HASHED = 1 << 62  # From here on ids stand for texts


@dataclass(frozen=True, slots=True)
class Line:
    """One line that isn't empty."""

    path: Path
    number: int  # The file's first line is 1
    fields: list[str]

    @property
    def where(self) -> str:
        """For errors."""
        return f"{self.path} line {self.number}"


def lines(path: Path, separator: str | None = None) -> Iterator[Line]:
    """Yield the lines of a text that aren't blank, split at blanks or at a separator, without a byte order mark. Raises
    LogError where the file can't be read, or is no text, LimitError where a line has no end.
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
    """Return the number of a frame. Raises LogError where it is none, LimitError where it is beyond all reason."""
    try:
        number = int(text[:40])
    except ValueError:
        raise LogError(f"{where}: frame is '{text[:40]}', expected a whole number") from None
    if not 0 <= number < MAX_FRAMES:
        raise LimitError(f"{where}: frame is {number}, expected 0 to {MAX_FRAMES - 1}")
    return number


def digest_of(path: Path) -> str:
    """Return the blake2b-128 of a file; of a folder over names and digests of all files, in that order; or LogError."""
    digest = blake2b(digest_size=16)
    if not path.is_file():
        for file in sorted(file for file in path.rglob("*") if file.is_file()):
            entry = f"{file.relative_to(path).as_posix()}\n{digest_of(file)}\n"
            digest.update(entry.encode("utf-8", "surrogateescape"))
        return digest.hexdigest()
    try:
        with path.open("rb") as opened:
            while piece := opened.read(2**20):
                digest.update(piece)
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error
    return digest.hexdigest()


def stamp_of_seconds(text: str) -> int:
    """Return a stamp [ns] from seconds as a decimal text, exactly. ValueError: isn't a number, or doesn't fit int64."""
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        raise ValueError(f"'{text[:40]}' is no number of seconds") from None
    in_range = seconds.is_finite() and 0 <= seconds < _MAX_S
    if not in_range or (stamp_ns := int(seconds.scaleb(9).to_integral_value())) > _MAX_NS:
        raise ValueError(f"'{text[:40]}' is no stamp")
    return stamp_ns


def stamp_of_time(text: str) -> int:
    """Return a stamp [ns] from seconds (if many: ms, us or ns) since 1970, or a time in ISO 8601; or ValueError."""
    if "-" in text[1:] and ":" in text:
        # A date and time in UTC, unless it ends in an offset such as +01:00.
        date, ahead_ns = text.strip().replace(" ", "T").removesuffix("Z"), 0
        if (zone := _ZONE.search(text.strip())) is not None:
            date = date[: zone.start()]
            ahead_ns = (60 * int(zone[2]) + int(zone[3])) * 60_000_000_000 * (-1 if zone[1] == "-" else 1)
        if not _TIME.fullmatch(date) or (stamp_ns := int(np.datetime64(date, "ns").astype(np.int64)) - ahead_ns) < 0:
            raise ValueError(f"'{text[:40]}' is no stamp")
        return stamp_ns
    try:
        value = Decimal(text)
    except InvalidOperation:
        raise ValueError(f"'{text[:40]}' is no time") from None
    if not value.is_finite() or not 0 <= value <= _MAX_NS:
        raise ValueError(f"'{text[:40]}' is no time")
    digits = next(shift for limit, shift in ((11, 9), (14, 6), (17, 3), (19, 0)) if value < Decimal(10) ** limit)
    return min(int(value.scaleb(digits).to_integral_value()), _MAX_NS)


def track_number(text: str) -> int:
    """Return a track id for what a file calls an object: whole numbers stay, other texts become a number of their own
    (a digest, so that it depends on nothing else); -1 where there is none.
    """
    text = text.strip()
    if not text:
        return -1
    if text.lstrip("-").isascii() and text.lstrip("-").isdigit() and len(text) < 19:
        return max(int(text), -1)
    digest = blake2b(text.encode("utf-8", "surrogatepass"), digest_size=8).digest()
    return _HASHED + int.from_bytes(digest, "little") % _HASHED


def is_number(text: str) -> bool:
    """Tell whether a text is a number, also one that isn't finite."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def parse_number(text: str, where: str, column: str) -> float:
    """Return a number, also one that isn't finite. Raises LogError where the text is none."""
    try:
        return float(text)
    except ValueError:
        raise LogError(f"{where}: {column} is '{text[:40]}', expected a number") from None


def whole(text: str, where: str, column: str) -> int:
    """Return a whole number that fits an int64. Raises LogError where the text is none."""
    value = parse_number(text, where, column)
    if not (abs(value) < 2**53 and value == int(value)):
        raise LogError(f"{where}: {column} is '{text[:40]}', expected a whole number")
    return int(value)
