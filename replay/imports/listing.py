"""Finding the files of datasets."""

import re
from pathlib import Path

from fbench.replay.errors import LogError
from fbench.replay.imports.wish import FrameRange

_ALL = FrameRange()


def entries(folder: Path) -> list[Path]:
    """Return what is in a folder, sorted by name; nothing where there is no such folder.

    Raises:
        LogError: where it can't be read.
    """
    try:
        return sorted(folder.iterdir()) if folder.is_dir() else []
    except OSError as error:
        raise LogError(f"{folder}: {error.strerror}") from error


def numbered(folder: Path, suffixes: tuple[str, ...], digits: int, frames: FrameRange = _ALL) -> dict[int, Path]:
    """Return the files of a folder that are named by a number of so many digits, ascending; none where it isn't there.

    Raises:
        LogError: where the folder can't be read.
    """
    found = {int(p.stem): p for p in entries(folder) if p.suffix in suffixes and is_number(p.stem, digits)}
    return {number: found[number] for number in sorted(found) if number in frames}


def is_number(text: str, digits: int) -> bool:
    """Tell whether a text is a number of so many digits."""
    return re.fullmatch(f"[0-9]{{{digits}}}", text) is not None
