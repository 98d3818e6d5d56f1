"""Files of a RADIATE sequence and their times."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from fbench.datasets.importing.files import entries, find_numbered
from fbench.datasets.radiate.calibration import FILE_NAME, LEFT, LIDAR, RIGHT
from fbench.datasets.radiate.radar import RADAR
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import BadInput, FrameRange, read_text, require_folder

GPS = "gps_imu"
POLAR, CARTESIAN = "Navtech_Polar", "Navtech_Cartesian"
ANNOTATIONS, META = Path("annotations/annotations.json"), Path("meta.json")
FOLDERS: Mapping[str, str] = {RADAR: POLAR, LIDAR: LIDAR, LEFT: LEFT, RIGHT: RIGHT, GPS: "GPS_IMU_Twist"}
"""Of each sensor, in the order in which messages of one instant are written."""
_SUFFIXES = {RADAR: ".png", LIDAR: ".csv", LEFT: ".png", RIGHT: ".png", GPS: ".txt"}
_GPS_MARGIN_NS = 2_000_000_000
_LINE = re.compile(r"Frame:\s*(\d{1,12})\s+Time:\s*(\d{1,10})\.(\d{1,9})", re.ASCII)
_MAX_S = 2**63 // 10**9
_EVER = range(-(2**64), 2**64)  # [ns]


def read_stamps(path: Path, bad: BadInput) -> dict[int, int]:
    """Return stamps [ns] by frame number, in the order of the file.

    The recorder wrote the nanoseconds as a number, without leading zeros: `.5` is 5 ns (SDK, `__timestamp_format`).
    Raises LogError naming the file and a line that isn't like `Frame: 000001 Time: 1574859771.744660272`, or gives a
    frame another time.
    """
    stamps: dict[int, int] = {}
    for i, line in enumerate(read_text(path).split("\n"), 1):
        if not (text := line.strip()):
            continue
        where, parts = f"{path}: line {i}", _LINE.fullmatch(text)
        if parts is None:
            why = f"'{text[:80]}', expected one like 'Frame: 000001 Time: 1574859771.744660272'"
            bad.report(LogError(f"{where}: {why}"))
            continue
        number, seconds, nanoseconds = map(int, parts.groups())
        if seconds >= _MAX_S:
            bad.report(LogError(f"{where}: {parts[2]} seconds are no time"))
        elif stamps.setdefault(number, stamp_ns := seconds * 1_000_000_000 + nanoseconds) != stamp_ns:
            bad.report(LogError(f"{where}: frame {number} has another time already"))
    return stamps


class Due(NamedTuple):
    """One file with its time; sorts as messages are written."""

    stamp_ns: int
    rank: int  # Place of its sensor in `FOLDERS`, which orders files of one instant
    number: int  # Of the frame, as the file's name says
    sensor: str


@dataclass(frozen=True)
class Stream:
    """The files of one sensor."""

    stamps: Mapping[int, int]
    """[ns] by frame number, of frames that have both a file and a time; in the order of the table."""
    no_file: Sequence[int]  # Frames that have a time alone
    no_stamp: Sequence[int]  # Frames that have a file alone


@dataclass(frozen=True)
class SequenceFiles:
    """The files of one sequence."""

    root: Path
    streams: Mapping[str, Stream]  # Of sensors that have a folder or a table of stamps
    cartesian: Mapping[int, int]
    """Stamps [ns] of the Cartesian radar images, on which labels were drawn; empty where their table is absent."""

    def path(self, due: Due) -> Path:
        """Where the file of a message is."""
        return self.root / FOLDERS[due.sensor] / f"{due.number:06d}{_SUFFIXES[due.sensor]}"

    @property
    def sensors(self) -> tuple[str, ...]:
        """Sensors that are there and have calibration, sorted."""
        return tuple(sorted(name for name in self.streams if name != GPS))


def sequences(source: Path) -> list[Path]:
    """Folders of sequences: `source`, or all in it that are one, by name. Raises LogError where there is none."""
    require_folder(source)
    for folders in ([source], entries(source)):
        if found := [path for path in folders if (path / POLAR).is_dir() or (path / CARTESIAN).is_dir()]:
            return found
    raise LogError(f"{source}: no sequence of RADIATE: no {POLAR}/ in it, nor in any folder in it")


def calibration_path(root: Path, chosen: Path | None) -> Path:
    """The chosen calibration, else that in the sequence or beside it. Raises LogError where there is none."""
    if chosen is not None:
        return chosen
    for folder in (root, root.resolve().parent):
        if (folder / FILE_NAME).is_file():
            return folder / FILE_NAME
    why = f"name that of the SDK (config/{FILE_NAME}) with --set calibration=FILE"
    raise LogError(f"{root}: no {FILE_NAME} in it or beside it; {why}")


def scan(root: Path, bad: BadInput) -> SequenceFiles:
    """Find files and their stamps. LogError: no polar radar image, or a sensor has files and no table of stamps."""
    for name in (POLAR, f"{POLAR}.txt"):
        if not (root / name).exists():
            raise LogError(f"{root}: no {name}, without polar radar images it can't be imported")
    streams = {}
    for sensor, folder in FOLDERS.items():
        table = root / f"{folder}.txt"
        if (root / folder).is_dir() or table.is_file():
            numbers = find_numbered(root / folder, (_SUFFIXES[sensor],), 6).keys()
            if not table.is_file():
                raise LogError(f"{table}: no such file, so no file in {folder}/ has a time")
            stamps = read_stamps(table, bad)
            both = {number: stamp for number, stamp in stamps.items() if number in numbers}
            streams[sensor] = Stream(both, sorted(stamps.keys() - numbers), sorted(numbers - stamps.keys()))
    if not streams[RADAR].stamps:
        raise LogError(f"{root / POLAR}: no image that {POLAR}.txt has a time of")
    table = root / f"{CARTESIAN}.txt"
    return SequenceFiles(root, streams, read_stamps(table, bad) if table.is_file() else {})


def dues(files: SequenceFiles, frames: FrameRange, gps_offset_ns: int) -> list[Due]:
    """Return what is to be imported, by time: chosen radar frames, and of other sensors what lies in their span: half a
    period before the first to half a period after the last, where the period is the median distance of all radar
    stamps; everything where all are chosen.

    Poses more than 2 s away from all of it are left out, and all but the first of equal stamps: the recorder wrote
    some fixes twice. Raises LogError where there is none of the chosen frames.
    """
    radar = files.streams[RADAR].stamps
    chosen = [stamp for number, stamp in radar.items() if number in frames]
    if not chosen:
        raise LogError(f"{files.root}: no radar frame {frames}, there are {min(radar)} to {max(radar)}")
    steps = sorted(b - a for a, b in pairwise(sorted(radar.values())))
    half_ns = steps[len(steps) // 2] // 2 if steps else 0
    span = _EVER if frames.is_whole else range(min(chosen) - half_ns, max(chosen) + half_ns + 1)
    found = [
        Due(stamp, rank, number, sensor)
        for rank, sensor in enumerate(FOLDERS)
        if sensor != GPS and sensor in files.streams
        for number, stamp in files.streams[sensor].stamps.items()
        if (number in frames if sensor == RADAR else stamp in span)
    ]
    if GPS in files.streams:
        first, last = max(min(found).stamp_ns - _GPS_MARGIN_NS, 0), max(found).stamp_ns + _GPS_MARGIN_NS
        fixes: dict[int, int] = {}  # Frame numbers by stamp
        for number, stamp in files.streams[GPS].stamps.items():
            fixes.setdefault(stamp + gps_offset_ns, number)
        rank = list(FOLDERS).index(GPS)
        found += [Due(at, rank, number, GPS) for at, number in fixes.items() if at in span and first <= at <= last]
    return sorted(found)
