"""Finding the files of the object and tracking benchmarks."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from fbench.datasets.kitti.rig import LIDAR, camera_name
from fbench.replay.boxfiles.text import Line, lines
from fbench.replay.errors import LimitError, LogError
from fbench.replay.imports.wish import FrameRange

SPLITS = ("training", "testing")
IMAGES = (".png", ".jpg")
POINTS = (".bin",)
SENSORS: Mapping[str, tuple[str, ...]] = {camera_name(2): IMAGES, camera_name(3): IMAGES, LIDAR: POINTS}
"""Suffixes of files by the sensors that the benchmarks have, in the order in which one becomes the reference."""
_MAX_TEXT_BYTES = 64 * 2**20


def split_folders(source: Path) -> Mapping[str, Path]:
    """Return the folders that may hold a benchmark's files, by what names of sequences begin with: `source` itself;
    else its `training/` and `testing/`, which are told apart by name where both are there.
    """
    inner = [source / split for split in SPLITS if (source / split).is_dir()]
    if len(inner) > 1:
        return {f"{folder.name}/": folder for folder in inner}
    return {"": inner[0] if inner else source}


def numbered(folder: Path, suffixes: tuple[str, ...], digits: int, frames: FrameRange) -> dict[int, Path]:
    """Return the files of a folder that are named by a number of so many digits, sorted; none where it isn't there.

    Raises:
        LogError: where the folder can't be read.
    """
    found = {int(p.stem): p for p in entries(folder) if p.suffix in suffixes and _is_number(p.stem, digits)}
    return {number: found[number] for number in sorted(found) if number in frames}


def numbered_folders(folder: Path, digits: int) -> list[str]:
    """Return the names of the folders inside one that are numbers of so many digits, sorted."""
    return [path.name for path in entries(folder) if _is_number(path.name, digits) and path.is_dir()]


def entries(folder: Path) -> list[Path]:
    """Return what is in a folder, sorted by name; nothing where there is no such folder.

    Raises:
        LogError: where it can't be read.
    """
    try:
        return sorted(folder.iterdir()) if folder.is_dir() else []
    except OSError as error:
        raise LogError(f"{folder}: {error.strerror}") from error


def bounded_lines(path: Path, comma: bool = False) -> Iterator[Line]:
    """Return the lines of a text that tells of all frames, split at blanks or commas; it is never large.

    Raises:
        LogError: where it can't be read, or isn't UTF-8.
        LimitError: where it is too large.
    """
    if path.is_file() and (size := path.stat().st_size) > _MAX_TEXT_BYTES:
        raise LimitError(f"{path}: {size} bytes, more than {_MAX_TEXT_BYTES}; no such file of KITTI is that large")
    return lines(path, "," if comma else None)


def _is_number(text: str, digits: int) -> bool:
    return re.fullmatch(f"[0-9]{{{digits}}}", text) is not None
