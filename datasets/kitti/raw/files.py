"""Files of a raw drive of KITTI, their stamps, and the order in which they are read."""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from fbench.datasets.importing.files import entries
from fbench.datasets.kitti.oxts import SENSOR as OXTS
from fbench.datasets.kitti.sensors import LIDAR, camera_name
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import FrameRange, read_text
from fbench.replay.formats.text import MAX_FRAMES, stamp_of_time

_DATE = re.compile(r"\d{4}_\d\d_\d\d", re.ASCII)
_DRIVE = re.compile(r"\d{4}_\d\d_\d\d_drive_\d+_(sync|extract)", re.ASCII)
_STAMP = re.compile(r"(\d{4})-\d\d-\d\d \d\d:\d\d:\d\d(\.\d{1,9})?", re.ASCII)
_NUMBERED = re.compile(r"(\d{1,10})\.([a-z]+)", re.ASCII)
_MAX_STAMPS_BYTES = 2**25
_YEARS = range(1970, 2262)
CAMERAS = {camera_name(number): number for number in range(4)}
_IMAGES = ("png", "jpg", "jpeg")
_FOLDERS = {LIDAR: "velodyne_points"}  # Of sensors whose folders have other names
Met = Callable[[LogError], None]
_END_NS = 2**63  # Behind all stamps, which aren't negative


@dataclass(frozen=True)
class Series:
    """The files of one sensor of a drive."""

    sensor: str
    folder: Path
    paths: Mapping[int, Path]  # By the number in the file's name, ascending
    others: tuple[str, ...] = ()  # Names in the folder that aren't those of measurements

    @property
    def stamps_path(self) -> Path:
        """File of which line N + 1 is the stamp of file N."""
        return self.folder / "timestamps.txt"


@dataclass(frozen=True)
class Drive:
    """One drive's folder."""

    name: str
    folder: Path
    series: Mapping[str, Series]  # By sensor; sensors without a file are absent

    @property
    def calibration_folder(self) -> Path:
        """Folder of the date."""
        return self.folder.parent

    @property
    def is_rectified(self) -> bool:
        """Whether images are rectified and the sensors' files have the numbers of common frames (`_sync`)."""
        return self.name.endswith("_sync")

    @property
    def reference(self) -> str:
        """The sensor whose stamps are the frames' instants: LiDAR, else a camera, the left color one if there is."""
        wanted = (LIDAR, camera_name(2), *CAMERAS)
        return next(name for name in wanted if name in self.series)

    @property
    def cameras(self) -> dict[str, int]:
        """Numbers of the cameras by name."""
        return {name: number for name, number in CAMERAS.items() if name in self.series}


def find_drives(source: Path) -> dict[str, Path]:
    """Return the folders of drives by name, sorted, in `source`, which holds dates, is one, or is a drive."""
    here = source.resolve()
    if not here.is_dir():
        return {}
    if _DRIVE.fullmatch(here.name):
        return {here.name: here}
    dates = [path for path in entries(here) if _DATE.fullmatch(path.name) and path.is_dir()]
    paths = [path for folder in (*dates, here) for path in entries(folder) if _DRIVE.fullmatch(path.name)]
    return dict(sorted((path.name, path) for path in paths if path.is_dir()))


def open_drive(name: str, folder: Path) -> Drive:
    """List the files of a drive. Raises LogError where a folder can't be read, or there is no measurement."""
    endings = {LIDAR: ("bin",) if name.endswith("_sync") else ("txt", "bin"), OXTS: ("txt",)}
    found = []
    for sensor in (*CAMERAS, LIDAR, OXTS):
        inner, others = folder / _FOLDERS.get(sensor, sensor), []
        paths: dict[int, Path] = {}
        for path in entries(inner / "data"):
            match = _NUMBERED.fullmatch(path.name)
            if match is None or match[2] not in endings.get(sensor, _IMAGES) or int(match[1]) >= MAX_FRAMES:
                others.append(path.name)
            elif (twin := paths.setdefault(int(match[1]), path)) is not path:
                raise LogError(f"{path}: has the number of {twin.name}; remove one of them")
        found.append(Series(sensor, inner, dict(sorted(paths.items())), tuple(others)))
    drive = Drive(name, folder, {series.sensor: series for series in found if series.paths})
    if not set(drive.series) - {OXTS}:
        places = ", ".join(f"{series.folder.name}/data" for series in found if series.sensor != OXTS)
        raise LogError(f"{folder}: no image and no point cloud, expected files in {places}")
    return drive


def _parse_stamp(path: Path, lines: Sequence[str], number: int) -> int:
    """Stamp of a file; KITTI writes no time zone, it is taken as UTC. Lines are empty where a measurement was lost."""
    if number >= len(lines):
        raise LogError(f"{path}: {len(lines)} lines, no stamp for file {number}")
    text = lines[number].strip()
    match = _STAMP.fullmatch(text)
    try:
        if match is None or int(match[1]) not in _YEARS:
            raise ValueError(text)
        return stamp_of_time(text)
    except ValueError as error:
        what = f"'{text[:40]}' is no stamp, expected one as 2011-09-26 13:02:25.964389445"
        what = what if text else f"no stamp for file {number}"
        raise LogError(f"{path}: line {number + 1}: {what}") from error


class Entry(NamedTuple):
    """One file."""

    stamp_ns: int
    sensor: str
    number: int


def order_files(drive: Drive, sensors: Collection[str], frames: FrameRange, met: Met) -> list[Entry]:
    """Return the files of some sensors that belong to a range of frames, by stamp.

    Numbers of files are those of frames in rectified drives. In others each sensor counts for itself: the range is one
    of the reference sensor's files, and takes what was recorded from its first stamp on until the first one after it.
    `met` gets files without a stamp, and sensors without stamps. Raises LogError where `met` does, or the range is
    empty.
    """
    series = [series for name, series in sorted(drive.series.items()) if name in sensors]
    if drive.is_rectified:
        chosen = [entry for one in series for entry in _entries(one, frames, met)]
    else:
        everything = [entry for one in series for entry in _entries(one, FrameRange(), met)]
        reference = [entry for entry in everything if entry.sensor == drive.reference]
        inside = [entry.stamp_ns for entry in reference if entry.number in frames]
        behind = [entry.stamp_ns for entry in reference if frames.stop is not None and entry.number >= frames.stop]
        first_ns = min(inside) if inside and frames.first else 0
        end_ns = min(behind, default=_END_NS) if inside else 0
        chosen = [entry for entry in everything if first_ns <= entry.stamp_ns < end_ns]
    if not chosen:
        numbers = list(drive.series[drive.reference].paths)
        raise LogError(f"{drive.folder}: no measurement in frames {frames}; there are {numbers[0]} to {numbers[-1]}")
    return sorted(chosen)


def _entries(series: Series, frames: FrameRange, met: Met) -> Iterator[Entry]:
    try:
        # Empty lines at the end are no matter.
        text = read_text(series.stamps_path, _MAX_STAMPS_BYTES).rstrip()
    except LogError as error:
        met(error)
        return
    lines = text.split("\n") if text else []
    for number in series.paths:
        if number in frames:
            try:
                yield Entry(_parse_stamp(series.stamps_path, lines, number), series.sensor, number)
            except LogError as error:
                met(error)
