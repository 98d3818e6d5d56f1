"""Files and import parameters of the object and tracking benchmarks."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from fbench.datasets.importing.files import entries, is_number, require_file
from fbench.datasets.kitti.rig import LIDAR, camera_name
from fbench.replay.contracts.errors import LimitError
from fbench.replay.formats.text import Line, lines

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


def numbered_folders(folder: Path, digits: int) -> list[str]:
    """Return the names of the folders inside one that are numbers of so many digits, sorted."""
    return [path.name for path in entries(folder) if is_number(path.name, digits) and path.is_dir()]


def bounded_lines(path: Path, comma: bool = False) -> Iterator[Line]:
    """Return the lines of a text that tells of all frames, split at blanks or commas; it is never large.

    Raises:
        LogError: where it can't be read, or isn't UTF-8.
        LimitError: where it is too large.
    """
    if path.exists():
        require_file(path)
    if path.is_file() and (size := path.stat().st_size) > _MAX_TEXT_BYTES:
        raise LimitError(f"{path}: {size} bytes, more than {_MAX_TEXT_BYTES}; no such file of KITTI is that large")
    return lines(path, "," if comma else None)


@dataclass(frozen=True)
class KittiParams:
    """Parameters of `Kitti`."""

    detections: Path | None = None
    """Folder with another system's results, `NNNN.txt` for each sequence of the tracking benchmark or `FFFFFF.txt` for
    each frame of the object benchmark; they become recorded results."""
