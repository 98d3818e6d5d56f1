"""MOTChallenge ground truth, detections and results: read and write.

A row is `frame,id,left,top,width,height[,confidence[,class,visibility]]`, or ends in `-1,-1,-1` or a place in space.
"""

from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Bool
from fbench.replay.data.messages import Truth
from fbench.replay.data.rig import CameraModel
from fbench.replay.formats.bulk_text import IrregularError, PlainText, parse_plain, read_bytes
from fbench.replay.formats.export_request import MOT_CLASSES, ExportRequest, LeftOut, namer
from fbench.replay.formats.objects import (
    Columns,
    Flat,
    LabeledObject,
    fill_frames,
    find_camera,
    group_by_frame,
    to_boxes2d,
    to_columns,
)
from fbench.replay.formats.sequence import BoxSequence, ImageRows, choose_camera, image_frames, small_ids
from fbench.replay.formats.text import MAX_FRAMES, Line, frame_number, lines, parse_number, whole
from fbench.replay.logs.coordinate_frames import CoordinateFrames
from fbench.replay.logs.setup import BoxSource

SHIFT_PX = 1.0
"""Pixels count from 1 there. Whether that is the middle or edge of the first pixel isn't defined; here the middle."""
_NUMBERS = {name: number for number, (name, _) in MOT_CLASSES.items()}
_DISTRACTOR = "distractor"  # Class of what is neither a hit nor a miss
_SURE = 1.0  # Confidence of results that have no score
_S = 1_000_000_000


def open_mot(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> Iterator[Truth]:
    """Read `gt.txt`, `det.txt` or a tracker's results: comma-separated, a row a box. A folder is one sequence, of which
    `gt/gt.txt` is taken, else `det/det.txt`; its `seqinfo.ini` tells how many frames are labeled. A frame's number is
    its place among the log's frames, the first being 1. Raises ConfigError where the camera isn't known. Raises
    LogError where there is no such file, or a row can't be read.
    """
    path = source.path
    camera = find_camera(source.camera or source.frame, coordinates, str(path))
    files = [path / "gt" / "gt.txt", path / "det" / "det.txt", path / "gt.txt", path / "det.txt"]
    file = path if path.is_file() else next((file for file in files if file.is_file()), None)
    if file is None:
        raise LogError(f"{path}: no gt/gt.txt and no det/det.txt")
    is_truth = file.stem.startswith("gt") or None
    rows = (parse_mot_row(line, camera, is_truth) for line in lines(file, ","))
    for frame, objects in fill_frames(group_by_frame(rows), 1, sequence_length(file) or 0):
        yield Truth(0, 0, None, to_boxes2d(objects), frame_index=frame - 1)


def find_sequence_info(file: Path) -> Path | None:
    """Return the `seqinfo.ini` near a file of boxes."""
    near = (folder / "seqinfo.ini" for folder in (file.parent, file.parent.parent))
    return next(filter(Path.is_file, near), None)


def sequence_length(file: Path) -> int | None:
    """Return how many frames the `seqinfo.ini` near a file of boxes gives, if there is one. LogError: it gives none."""
    if (path := find_sequence_info(file)) is None:
        return None
    import configparser  # takes a while to import, for a file that hardly any sequence has

    parser = configparser.ConfigParser(interpolation=None)
    try:
        parser.read_string(path.read_text(encoding="utf-8-sig"))
        text = parser.get("Sequence", "seqLength")
    except (configparser.Error, OSError, UnicodeDecodeError) as error:
        raise LogError(f"{path}: no seqLength in [Sequence] ({str(error).splitlines()[0]})") from error
    return min(frame_number(text, f"{path} seqLength"), MAX_FRAMES)


def parse_mot_row(
    line: Line, camera: str, is_truth: bool | None, shift_px: float = SHIFT_PX
) -> tuple[int, LabeledObject]:
    """Return the frame of a row, counted from 1, and its object in the image of `camera`.

    MOT16 and later have nine columns with class and visibility, MOT15 ten with -1, -1, -1 or a place behind the
    confidence. In ten columns of results the eighth is a class all the same where it is the number of one, as
    TrackEval reads it. In truth the confidence says that the row counts, 1, or that it doesn't, 0; where `is_truth` is
    `None`, in rows with a class. `shift_px`, the position of the first pixel, is taken off. Raises LogError where a
    column is missing or isn't a number.
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
    has_class = len(fields) in (8, 9)
    kind = whole(fields[7], where, "class") if has_class else _class_among_ten(fields, is_truth)
    name, label = MOT_CLASSES.get(kind, (str(kind), "other"))
    confidence = parse_number(fields[6], where, "confidence") if len(fields) > 6 else None
    is_flag = has_class if is_truth is None else is_truth
    return frame, LabeledObject(
        name,
        None,
        Flat(camera, (left, top, left + width, top + height)),
        label,
        score=None if is_flag else confidence,
        track_id=max(whole(fields[1], where, "id"), -1),
        # Flags are 0 and 1, and other numbers are rounded towards 0, as TrackEval does.
        ignore=(confidence is not None and abs(confidence) < 1) if is_flag else None,
        visibility=parse_number(fields[8], where, "visibility") if len(fields) == 9 else None,
    )


def _class_among_ten(fields: list[str], is_truth: bool | None) -> int:
    """The class of a row without a column for it, 1 unless it is a result whose eighth column names one."""
    if len(fields) < 10 or is_truth is not False:
        return 1
    try:
        given = float(fields[7])
    except ValueError:
        return 1
    return int(given) if given in MOT_CLASSES else 1


def read_mot_columns(path: Path, is_truth: bool) -> Columns:
    """Read the file of one sequence; steps are frames from 0, positions the file's. LogError names row and column."""
    try:
        plain = parse_plain(read_bytes(path), ",")
        return to_columns([], []) if plain is None else _columns_at_once(plain, is_truth)
    except IrregularError:
        return _columns_by_row(path, is_truth)


def _columns_by_row(path: Path, is_truth: bool) -> Columns:
    found = [parse_mot_row(line, "image", is_truth, shift_px=0.0) for line in lines(path, ",")]
    return to_columns([frame - 1 for frame, _ in found], [row for _, row in found])


def _columns_at_once(plain: PlainText, is_truth: bool) -> Columns:
    if not 6 <= plain.width <= 10:
        raise IrregularError
    frames = plain.wholes(0)
    if frames.min() < 1 or frames.max() >= MAX_FRAMES:
        raise IrregularError
    left, top, width, height = plain.numbers((2, 3, 4, 5)).T
    kinds = np.ones(len(plain), np.int64)
    if plain.width in (8, 9):
        kinds = plain.wholes(7)
    elif plain.width == 10 and not is_truth:
        kinds = np.where(np.isin(plain.number(7), list(MOT_CLASSES)), plain.number(7), 1).astype(np.int64)
    confidence = plain.number(6) if plain.width > 6 else None
    ignored = np.zeros(len(frames), bool) if confidence is None or not is_truth else np.abs(confidence) < 1
    numbers, which = np.unique(kinds, return_inverse=True)
    names = [MOT_CLASSES[int(kind)][0] if int(kind) in MOT_CLASSES else str(kind) for kind in numbers]
    return {
        "step": frames - 1,
        "label": np.array(names, np.str_)[which].reshape(len(kinds)),
        "track_id": np.maximum(plain.wholes(1), -1),
        "score": np.zeros(len(frames)) if confidence is None or is_truth else confidence,
        "xyxy_px": np.column_stack([left, top, left + width, top + height]),
        "visibility": plain.number(8) if plain.width == 9 else None,
        "ignore": ignored if ignored.any() else None,
    }


def mot_rows(sequence: BoxSequence, request: ExportRequest, left: LeftOut) -> Iterator[list[str]]:
    """Yield the rows of each frame: `frame,id,left,top,width,height,` and then `confidence,-1,-1,-1` for results,
    `counts,class,visibility` for truth, as of MOT16. Frames and pixels count from 1; a frame's number is its place in
    the log. Raises ConfigError where a camera isn't known. Raises LogError where truth has no class, or boxes can't be
    projected.
    """
    camera = choose_camera(sequence, request.camera)
    frames = image_frames(sequence, camera, left)
    name_classes, small_id = namer(request, sequence.where), small_ids(sequence.boxes)
    highest = [small_id(int(boxes.track_id.max())) for boxes in sequence.boxes if boxes.track_id is not None]
    free = count(1 + max(highest, default=0))
    for frame, found in frames:
        ignored: Bool = found.column("ignore", False) if sequence.is_truth else np.zeros(len(found), bool)
        known = ignored | (found.column("track_id", -1) >= 0)
        left["without a track id"] += int(np.count_nonzero(~known))
        rows, ignored = found[known], ignored[known]
        if sequence.is_truth:
            names = np.full(len(rows), _DISTRACTOR, dtype=object)
            names[~ignored] = rows[~ignored].names(name_classes)
            has: Bool = names != ""
            left["of classes that MOTChallenge doesn't have"] += int(np.count_nonzero(~has))
            rows, ends = rows[has], _truth_ends(rows[has], names[has].tolist(), ignored[has])
        else:
            confidences = rows.column("score", np.nan).tolist()
            ends = [f"{_SURE if np.isnan(value) else value:.6f},-1,-1,-1" for value in confidences]
        # Regions that are ignored have ids there too, and no two rows of a frame the same.
        ids = [small_id(id_) if id_ >= 0 else next(free) for id_ in rows.column("track_id", -1).tolist()]
        corner, size = rows.xyxy_px[:, :2] + SHIFT_PX, rows.xyxy_px[:, 2:] - rows.xyxy_px[:, :2]
        yield [
            f"{frame.index + 1},{id_},{left_:.4f},{top:.4f},{width:.4f},{height:.4f},{end}"
            for id_, (left_, top), (width, height), end in zip(ids, corner.tolist(), size.tolist(), ends, strict=True)
        ]


def _truth_ends(rows: ImageRows, names: list[Any], ignored: Bool) -> list[str]:
    columns = zip(ignored, names, rows.column("visibility", np.nan).tolist(), strict=True)
    return [
        f"{0 if skip else 1},{_NUMBERS[name]},{share if 0 <= share <= 1 else 1.0:.4f}" for skip, name, share in columns
    ]


def seqinfo(name: str, sequence: BoxSequence, camera: CameraModel | None) -> str:
    """Return the text of `seqinfo.ini`: the rate is that of the stamps' median distance; what isn't known is 0."""
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
