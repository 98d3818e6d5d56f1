"""MOTChallenge: ground truth, detections and results (https://motchallenge.net/instructions)."""

import configparser
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from fbench.replay.boxfiles.kitti import filled, in_order
from fbench.replay.boxfiles.parse import number, whole
from fbench.replay.boxfiles.placing import camera_of
from fbench.replay.boxfiles.rows import Flat, Labelled, flats
from fbench.replay.boxfiles.text import MAX_FRAMES, Line, frame_number, lines
from fbench.replay.data import Truth
from fbench.replay.errors import LogError
from fbench.replay.faults import FaultLog
from fbench.replay.logs.coordinates import CoordinateFrames
from fbench.replay.logs.setup import BoxSource

CLASSES = {
    1: ("pedestrian", "pedestrian"), 2: ("person on vehicle", "pedestrian"), 3: ("car", "car"),
    4: ("bicycle", "bicycle"), 5: ("motorbike", "motorcycle"), 6: ("non motorized vehicle", "other"),
    7: ("static person", "pedestrian"), 8: ("distractor", "other"), 9: ("occluder", "other"),
    10: ("occluder on the ground", "other"), 11: ("occluder full", "other"), 12: ("reflection", "other"),
    13: ("crowd", "other"),
}  # fmt: skip
"""Name and label by the number of MOT16 and later."""
SHIFT_PX = 1.0
"""Pixels count from 1 there, from 0 here. Whether 1 is the middle or the edge of the first pixel isn't defined; the
middle is taken."""


@dataclass(frozen=True)
class _Sequence:
    """Which file, and what `seqinfo.ini` says."""

    path: Path
    num_frames: int
    is_truth: bool | None


def open_mot(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> Iterator[Truth]:
    """Read `gt.txt`, `det.txt` or a tracker's results: comma-separated, a row a box. A folder is one sequence, of which
    `gt/gt.txt` is taken, else `det/det.txt`; its `seqinfo.ini` tells how many frames are labelled. A frame's number
    is its place among the log's frames, the first being 1.

    Raises:
        ConfigError: where the camera isn't known.
        LogError: where there is no such file, or a row can't be read.
    """
    camera = camera_of(source.camera or source.frame, coordinates, str(source.path))
    sequence = _sequence(source.path)
    rows = (mot_row(line, camera, sequence.is_truth) for line in lines(sequence.path, ","))
    for frame, objects in filled(in_order(rows), 1, sequence.num_frames):
        yield Truth(0, 0, None, flats(objects), frame_index=frame - 1)


def _sequence(path: Path) -> _Sequence:
    files = [path / "gt" / "gt.txt", path / "det" / "det.txt", path / "gt.txt", path / "det.txt"]
    file = path if path.is_file() else next((file for file in files if file.is_file()), None)
    if file is None:
        raise LogError(f"{path}: no gt/gt.txt and no det/det.txt")
    near = [folder / "seqinfo.ini" for folder in (file.parent, file.parent.parent)]
    info = next((ini for ini in near if ini.is_file()), None)
    return _Sequence(file, 0 if info is None else sequence_length(info), file.stem.startswith("gt") or None)


def sequence_length(path: Path) -> int:
    """Return the number of frames that a `seqinfo.ini` tells.

    Raises:
        LogError: where it tells none.
    """
    parser = configparser.ConfigParser(interpolation=None)
    try:
        parser.read_string(path.read_text(encoding="utf-8-sig"))
        text = parser.get("Sequence", "seqLength")
    except (configparser.Error, OSError, UnicodeDecodeError) as error:
        raise LogError(f"{path}: no seqLength in [Sequence] ({str(error).splitlines()[0]})") from error
    return min(frame_number(text, f"{path} seqLength"), MAX_FRAMES)


def mot_row(line: Line, camera: str, is_truth: bool | None, shift_px: float = SHIFT_PX) -> tuple[int, Labelled]:
    """Return the frame of a row, counted from 1, and its object.

    Args:
        line: The row.
        camera: Whose image the box is in.
        is_truth: Whether its confidence says that it counts, 1, or that it doesn't, 0; `None`: in rows with a class.
        shift_px: Position of the first pixel, which is taken off.

    Raises:
        LogError: where a column is missing or isn't a number.
    """
    fields = [field for field in line.fields if field] if line.fields[-1] == "" else line.fields
    where = line.where
    if not 6 <= len(fields) <= 10:
        raise LogError(f"{where}: {len(fields)} columns, expected 6 to 10: frame, id, left, top, width, height ...")
    frame = frame_number(str(whole(fields[0], where, "frame")), where)
    if frame < 1:
        raise LogError(f"{where}: frame is 0, but MOTChallenge counts frames from 1")
    names = ("left", "top", "width", "height")
    left, top, width, height = (number(text, where, name) for name, text in zip(names, fields[2:6], strict=True))
    left, top = left - shift_px, top - shift_px
    flat = Flat(camera, (left, top, left + width, top + height))
    return frame, _labelled(fields, where, flat, is_truth)


def _class_among_ten(fields: list[str], is_truth: bool | None) -> int:
    """Return the class of a row that has no column for it, 1 unless it is a result whose eighth column names one."""
    if len(fields) < 10 or is_truth is not False:
        return 1
    try:
        told = float(fields[7])
    except ValueError:
        return 1
    return int(told) if told in CLASSES else 1


def _is_off(flag: float | None) -> bool:
    """Whether truth doesn't count: flags are 0 and 1, and other numbers are rounded towards 0, as TrackEval does."""
    return flag is not None and abs(flag) < 1


def _labelled(fields: list[str], where: str, flat: Flat, is_truth: bool | None) -> Labelled:
    """MOT16 and later have nine columns with class and visibility, MOT15 ten with -1, -1, -1 or a place behind the
    confidence. In ten columns of results the eighth is a class all the same where it is the number of one, as
    TrackEval reads it.
    """
    has_class = len(fields) in (8, 9)
    kind = whole(fields[7], where, "class") if has_class else _class_among_ten(fields, is_truth)
    name, label = CLASSES.get(kind, (str(kind), "other"))
    confidence = number(fields[6], where, "confidence") if len(fields) > 6 else None
    is_flag = has_class if is_truth is None else is_truth
    return Labelled(
        name, None, flat, label,
        score=None if is_flag else confidence,
        track_id=max(whole(fields[1], where, "id"), -1),
        ignore=_is_off(confidence) if is_flag else None,
        visibility=number(fields[8], where, "visibility") if len(fields) == 9 else None,
    )  # fmt: skip
