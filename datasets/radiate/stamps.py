"""Tables of stamps: `velo_lidar.txt` and the like."""

import re
from pathlib import Path

from fbench.replay.errors import LogError
from fbench.replay.imports.files import read_text
from fbench.replay.imports.wish import BadInput

_LINE = re.compile(r"Frame:\s*(\d{1,12})\s+Time:\s*(\d{1,10})\.(\d{1,9})", re.ASCII)
_MAX_S = 2**63 // 10**9


def stamp_ns(seconds: str, nanoseconds: str) -> int:
    """Return a stamp [ns] from the digits before and after the point.

    The recorder wrote the nanoseconds as a number, without leading zeros: `.5` is 5 ns (SDK, `__timestamp_format`).
    """
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def read_stamps(path: Path, bad: BadInput) -> dict[int, int]:
    """Return stamps [ns] by frame number, in the order of the file.

    Raises:
        LogError: naming the file and a line that isn't like `Frame: 000001 Time: 1574859771.744660272`, or gives a
            frame another time.
    """
    stamps: dict[int, int] = {}
    for i, line in enumerate(read_text(path).split("\n"), 1):
        if line.strip():
            try:
                number, stamp = _parsed(line, f"{path}: line {i}")
                if stamps.setdefault(number, stamp) != stamp:
                    raise LogError(f"{path}: line {i}: frame {number} has another time already")
            except LogError as error:
                bad.met(error)
    return stamps


def _parsed(line: str, where: str) -> tuple[int, int]:
    found = _LINE.fullmatch(line.strip())
    if found is None:
        text = line.strip()[:80]
        raise LogError(f"{where}: '{text}', expected one like 'Frame: 000001 Time: 1574859771.744660272'")
    if int(found[2]) >= _MAX_S:
        raise LogError(f"{where}: {found[2]} seconds are no time")
    return int(found[1]), stamp_ns(found[2], found[3])
