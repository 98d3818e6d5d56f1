"""MOTChallenge ground truth, detections and results: read and write."""

import configparser
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Bool
from fbench.replay.data.messages import Truth
from fbench.replay.data.rig import CameraModel
from fbench.replay.formats.class_names import MOT_NUMBERS, namer
from fbench.replay.formats.export_request import ExportWish, LeftOut
from fbench.replay.formats.kitti import filled, in_order
from fbench.replay.formats.objects import (
    MAX_FRAMES,
    Flat,
    Labelled,
    Line,
    flats,
    frame_number,
    lines,
    parse_number,
    whole,
)
from fbench.replay.formats.placing import camera_of
from fbench.replay.formats.sequence import BoxSequence, ImageRows, image_rows, require_view, small_ids
from fbench.replay.formats.sequence import camera_of as camera_of_of_sequence
from fbench.replay.logs.coordinate_frames import CoordinateFrames
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
    left, top, width, height = (parse_number(text, where, name) for name, text in zip(names, fields[2:6], strict=True))
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


def _labelled(fields: list[str], where: str, flat: Flat, is_truth: bool | None) -> Labelled:
    """MOT16 and later have nine columns with class and visibility, MOT15 ten with -1, -1, -1 or a place behind the
    confidence. In ten columns of results the eighth is a class all the same where it is the number of one, as
    TrackEval reads it.
    """
    has_class = len(fields) in (8, 9)
    kind = whole(fields[7], where, "class") if has_class else _class_among_ten(fields, is_truth)
    name, label = CLASSES.get(kind, (str(kind), "other"))
    confidence = parse_number(fields[6], where, "confidence") if len(fields) > 6 else None
    is_flag = has_class if is_truth is None else is_truth
    return Labelled(
        name, None, flat, label,
        score=None if is_flag else confidence,
        track_id=max(whole(fields[1], where, "id"), -1),
        ignore=(confidence is not None and abs(confidence) < 1) if is_flag else None,
        visibility=parse_number(fields[8], where, "visibility") if len(fields) == 9 else None,
    )  # fmt: skip


_DISTRACTOR = "distractor"
"""Class of what is neither a hit nor a miss."""
_SURE = 1.0
"""Confidence of results that have no score."""
_S = 1_000_000_000


def mot_rows(sequence: BoxSequence, wish: ExportWish, left: LeftOut) -> Iterator[list[str]]:
    """Yield the rows of each frame: `frame,id,left,top,width,height,` and then `confidence,-1,-1,-1` for results,
    `counts,class,visibility` for truth, as of MOT16. Frames and pixels count from 1; a frame's number is its place in
    the log.

    Raises:
        ConfigError: where a camera isn't known.
        LogError: where truth has no class, or boxes can't be projected.
    """
    camera = camera_of_of_sequence(sequence, wish.camera)
    require_view(sequence, camera)
    writer = _Writer(sequence, wish, left)
    for frame in sequence.frames:
        yield writer.texts(frame.index + 1, image_rows(frame, camera, left))


class _Writer:
    """Writes the rows of one sequence."""

    def __init__(self, sequence: BoxSequence, wish: ExportWish, left: LeftOut) -> None:
        self._is_truth, self._left = sequence.is_truth, left
        self._names = namer(wish, sequence.where)
        self._small = small_ids(sequence.boxes)
        self._free = 1 + max(
            (self._small(int(boxes.track_id.max())) for boxes in sequence.boxes if boxes.track_id is not None),
            default=0,
        )

    def texts(self, number: int, rows: ImageRows) -> list[str]:
        """Return the rows of a frame."""
        ignored: Bool = rows.column("ignore", False) if self._is_truth else np.zeros(len(rows), bool)
        known = ignored | (rows.column("track_id", -1) >= 0)
        self._left.add("without a track id", int(np.count_nonzero(~known)))
        rows, ignored = rows[known], ignored[known]
        if self._is_truth:
            names = self._classes(rows, ignored)
            has: Bool = names != ""
            self._left.add("of classes that MOTChallenge doesn't have", int(np.count_nonzero(~has)))
            rows, ends = rows[has], _truths(rows[has], names[has].tolist(), ignored[has])
        else:
            scores = rows.column("score", np.nan).tolist()
            ends = [f"{_SURE if np.isnan(score) else score:.6f},-1,-1,-1" for score in scores]
        ids = [self._id(id_) for id_ in rows.column("track_id", -1).tolist()]
        corner, size = rows.xyxy_px[:, :2] + SHIFT_PX, rows.xyxy_px[:, 2:] - rows.xyxy_px[:, :2]
        return [
            f"{number},{id_},{left:.4f},{top:.4f},{width:.4f},{height:.4f},{end}"
            for id_, (left, top), (width, height), end in zip(ids, corner.tolist(), size.tolist(), ends, strict=True)
        ]

    def _id(self, id_: int) -> int:
        """Regions that are ignored have ids there too, and no two rows of a frame the same."""
        if id_ >= 0:
            return self._small(id_)
        self._free += 1
        return self._free - 1

    def _classes(self, rows: ImageRows, ignored: Bool) -> "np.ndarray[Any, np.dtype[np.object_]]":
        """Class of each row (N,), empty where there is none for it."""
        names = np.full(len(rows), _DISTRACTOR, dtype=object)
        names[~ignored] = rows[~ignored].names(self._names)
        return names


def _truths(rows: ImageRows, names: Sequence[str], ignored: Bool) -> list[str]:
    visible = rows.column("visibility", np.nan).tolist()
    return [
        f"{0 if skip else 1},{MOT_NUMBERS[name]},{share if 0 <= share <= 1 else 1.0:.4f}"
        for skip, name, share in zip(ignored, names, visible, strict=True)
    ]


def seqinfo(name: str, sequence: BoxSequence, camera: CameraModel | None) -> str:
    """Return the text of `seqinfo.ini`: the rate is that of the stamps' median distance, 0 where there is none; so is
    the size of an image that isn't known.
    """
    stamps = np.array([frame.stamp_ns for frame in sequence.frames], np.int64)
    indices = np.array([frame.index for frame in sequence.frames], np.int64)
    periods_ns = np.diff(stamps) / np.maximum(np.diff(indices), 1)
    period_ns = float(np.median(periods_ns)) if len(periods_ns) else 0.0
    width, height = (0, 0) if camera is None else camera.size_wh
    rate = round(_S / period_ns) if period_ns > 0 else 0
    lines = (
        "[Sequence]", f"name={name}", "imDir=img1", f"frameRate={rate}", f"seqLength={sequence.num_frames}",
        f"imWidth={width}", f"imHeight={height}", "imExt=.jpg",
    )  # fmt: skip
    return "".join(f"{line}\n" for line in lines)
