"""Files of a RADIATE sequence and their times."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from fbench.datasets.importing.files import entries, find_numbered
from fbench.datasets.radiate.calibration import FILE_NAME, LEFT, LIDAR, RIGHT
from fbench.datasets.radiate.radar import SENSOR as RADAR
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import BadInput, FrameRange, read_text, require_folder

_LINE = re.compile(r"Frame:\s*(\d{1,12})\s+Time:\s*(\d{1,10})\.(\d{1,9})", re.ASCII)
_MAX_S = 2**63 // 10**9


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
        where, found = f"{path}: line {i}", _LINE.fullmatch(text)
        try:
            if found is None:
                raise LogError(f"{where}: '{text[:80]}', expected one like 'Frame: 000001 Time: 1574859771.744660272'")
            if int(found[2]) >= _MAX_S:
                raise LogError(f"{where}: {found[2]} seconds are no time")
            number, stamp_ns = int(found[1]), int(found[2]) * 1_000_000_000 + int(found[3])
            if stamps.setdefault(number, stamp_ns) != stamp_ns:
                raise LogError(f"{where}: frame {number} has another time already")
        except LogError as error:
            bad.report(error)
    return stamps


GPS = "gps_imu"
POLAR, CARTESIAN = "Navtech_Polar", "Navtech_Cartesian"
ANNOTATIONS, META = Path("annotations/annotations.json"), Path("meta.json")
FOLDERS: Mapping[str, str] = {RADAR: POLAR, LIDAR: LIDAR, LEFT: LEFT, RIGHT: RIGHT, GPS: "GPS_IMU_Twist"}
"""Of each sensor, in the order in which messages of one instant are written."""
_SUFFIXES = {RADAR: ".png", LIDAR: ".csv", LEFT: ".png", RIGHT: ".png", GPS: ".txt"}
_DIGITS = 6
_GPS_MARGIN_NS = 2_000_000_000


@dataclass(frozen=True)
class Due:
    """One file with its time."""

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
        return file_path(self.root, due.sensor, due.number)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Sensors that are there and have calibration, sorted."""
        return tuple(sorted(name for name in self.streams if name != GPS))


def file_path(root: Path, sensor: str, number: int) -> Path:
    """Where the file of a frame is."""
    return root / FOLDERS[sensor] / f"{number:0{_DIGITS}d}{_SUFFIXES[sensor]}"


def sequences(source: Path) -> list[Path]:
    """Folders of sequences: `source`, or all in it that are one, by name. Raises LogError where there is none."""
    require_folder(source)
    if _is_sequence(source):
        return [source]
    found = [path for path in entries(source) if path.is_dir() and _is_sequence(path)]
    if not found:
        raise LogError(f"{source}: no sequence of RADIATE: no {POLAR}/ in it, nor in any folder in it")
    return found


def _is_sequence(path: Path) -> bool:
    return (path / POLAR).is_dir() or (path / CARTESIAN).is_dir()


def calibration_path(root: Path, chosen: Path | None) -> Path:
    """Return the calibration that was chosen, or else the one in the sequence or in the folder of sequences. Raises
    LogError where there is none.
    """
    if chosen is not None:
        return chosen
    for folder in (root, root.resolve().parent):
        if (folder / FILE_NAME).is_file():
            return folder / FILE_NAME
    raise LogError(
        f"{root}: no {FILE_NAME} in it or beside it; name that of the SDK (config/{FILE_NAME}) with "
        "--set calibration=FILE"
    )


def scan(root: Path, bad: BadInput) -> SequenceFiles:
    """Find the files of a sequence and read their stamps. Raises LogError where there is no polar radar image, or a
    sensor has files and no table of stamps.
    """
    for name in (POLAR, f"{POLAR}.txt"):
        if not (root / name).exists():
            raise LogError(f"{root}: no {name}, without polar radar images it can't be imported")
    streams = {}
    for sensor, folder in FOLDERS.items():
        if (root / folder).is_dir() or (root / f"{folder}.txt").is_file():
            streams[sensor] = _stream(root, sensor, bad)
    if not streams[RADAR].stamps:
        raise LogError(f"{root / POLAR}: no image that {POLAR}.txt has a time of")
    table = root / f"{CARTESIAN}.txt"
    return SequenceFiles(root, streams, read_stamps(table, bad) if table.is_file() else {})


def _stream(root: Path, sensor: str, bad: BadInput) -> Stream:
    folder = root / FOLDERS[sensor]
    numbers = set(find_numbered(folder, (_SUFFIXES[sensor],), _DIGITS))
    table = folder.with_name(f"{folder.name}.txt")
    if not table.is_file():
        raise LogError(f"{table}: no such file, so no file in {folder.name}/ has a time")
    stamps = read_stamps(table, bad)
    return Stream(
        {number: stamp for number, stamp in stamps.items() if number in numbers},
        sorted(stamps.keys() - numbers),
        sorted(numbers - stamps.keys()),
    )


@dataclass(frozen=True)
class Span:
    """From when to when messages are imported [ns], both included; `None`: all."""

    first_ns: int | None
    last_ns: int | None

    def __contains__(self, stamp: int) -> bool:
        return (self.first_ns is None or self.first_ns <= stamp) and (self.last_ns is None or stamp <= self.last_ns)


def span_of(radar: Stream, frames: FrameRange, root: Path) -> Span:
    """Return the span that belongs to the chosen radar frames: half a period before the first to half a period after
    the last, where the period is the median distance of all radar stamps; everything where all are chosen. Raises
    LogError where there is none of them.
    """
    if frames.is_whole:
        return Span(None, None)
    chosen = [stamp for number, stamp in radar.stamps.items() if number in frames]
    if not chosen:
        raise LogError(f"{root}: no radar frame {frames}, there are {min(radar.stamps)} to {max(radar.stamps)}")
    ordered = sorted(radar.stamps.values())
    steps = sorted(b - a for a, b in pairwise(ordered))
    half_ns = steps[len(steps) // 2] // 2 if steps else 0
    return Span(min(chosen) - half_ns, max(chosen) + half_ns)


def dues(files: SequenceFiles, frames: FrameRange, gps_offset_ns: int) -> list[Due]:
    """Return what is to be imported, by time: chosen radar frames, and of other sensors what lies in their span.

    Poses more than 2 s away from all of it are left out, and all but the first of equal stamps: the recorder wrote
    some fixes twice.
    """
    span = span_of(files.streams[RADAR], frames, files.root)
    found: list[Due] = []
    for rank, sensor in enumerate(FOLDERS):
        if sensor != GPS and sensor in files.streams:
            for number, stamp in files.streams[sensor].stamps.items():
                if number in frames if sensor == RADAR else stamp in span:
                    found.append(Due(stamp, rank, number, sensor))
    first = max(min(due.stamp_ns for due in found) - _GPS_MARGIN_NS, 0)
    around = Span(first, max(due.stamp_ns for due in found) + _GPS_MARGIN_NS)
    if GPS in files.streams:
        rank, seen = list(FOLDERS).index(GPS), set()
        for number, recorded in files.streams[GPS].stamps.items():
            stamp = recorded + gps_offset_ns
            if stamp in span and stamp in around and stamp not in seen:
                seen.add(stamp)
                found.append(Due(stamp, rank, number, GPS))
    return sorted(found, key=lambda due: (due.stamp_ns, due.rank, due.number))
