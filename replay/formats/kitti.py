"""KITTI labels and results, the object benchmark's and the tracking benchmark's: read and write.

A row is `class truncated occluded alpha left top right bottom height width length x y z rotation_y [score]`; in the
tracking benchmark frame and id come first. Location is the middle of the bottom in the camera's coordinates (x right,
y down, z forward); `rotation_y` turns about y, 0 where the object faces x. AB3DMOT takes detections
(https://github.com/xinshuoweng/AB3DMOT) with the same numbers in another order:
`frame,class,left,top,right,bottom,score,height,width,length,x,y,z,rotation_y,alpha`.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Bool, Float64, Int64, Text
from fbench.replay.data.messages import Truth
from fbench.replay.formats.bulk_text import IrregularError, PlainText, parse_plain, read_bytes
from fbench.replay.formats.export_request import ExportRequest, LeftOut, namer
from fbench.replay.formats.objects import (
    Columns,
    Flat,
    Frames,
    LabeledObject,
    Solid,
    body_T,
    fill_frames,
    find_camera,
    group_by_frame,
    to_boxes2d,
    to_boxes3d,
    to_columns,
)
from fbench.replay.formats.recognition import AB3DMOT_COLUMNS
from fbench.replay.formats.sequence import (
    CAMERA_T_LEVEL,
    BoxSequence,
    ImageRows,
    body_T_level,
    choose_camera,
    coordinate_frame,
    image_frames,
    small_ids,
)
from fbench.replay.formats.text import MAX_FRAMES, Line, frame_number, lines, parse_number, whole
from fbench.replay.geometry.iou import move_boxes
from fbench.replay.geometry.transforms import inverse
from fbench.replay.logs.coordinate_frames import CoordinateFrames
from fbench.replay.logs.setup import BoxSource

DONT_CARE = "DontCare"
_NAMES = (
    "truncated", "occluded", "alpha", "left", "top", "right", "bottom", "height", "width", "length", "x", "y", "z",
    "rotation_y", "score",
)  # fmt: skip
_NUM_TRACKING, _NUM_OBJECT = 17, 15  # Columns without a score
UNKNOWN_ALPHA = -10
_COLUMNS_CAMERA = "image"
ALPHA = re.compile(r"alpha=(-?[0-9]{1,4}(?:\.[0-9]{1,9})?)")
"""Attribute of 2D truth: the angle as the label file gave it, which doesn't follow from the box."""
_ZERO = re.compile(r"(?<!\S)-(?=0\.0*(?!\S))")  # Sign of a number that is rounded to zero
_UNKNOWN_BOX = (-1.0, -1.0, -1.0, -1000.0, -1000.0, -1000.0, -10.0)
"""Height, width, length, x, y, z, rotation_y of an object without a 3D box."""
_SURE = 1.0  # Score of results that have none
_MARGIN_RAD = 1e-6  # Labels with six decimals go so far beyond pi
_IGNORED_TRACKING = " ".join(f"{value:.6f}" for value in (-1000, -1000, -1000, -10, -1, -1, -1))
"""Numbers behind the 2D box of an ignored region, in an order that differs between tracking and object benchmark."""
_IGNORED_OBJECT = "-1 -1 -1 -1000 -1000 -1000 -10"
_AB3DMOT_NAMES = (
    "left", "top", "right", "bottom", "score", "height", "width", "length", "x", "y", "z", "rotation_y", "alpha",
)  # fmt: skip
_AB3DMOT_CLASSES = {1: "Pedestrian", 2: "Car", 3: "Cyclist"}


def parse_object_row(line: Line, fields: Sequence[str], camera: str, track_id: int | None) -> LabeledObject:
    """Return the object of a row, whose 2D box is in the image of `camera`, its 3D box at the camera with x forward,
    y left, z up. `fields` are its class, then 14 or 15 numbers. Raises LogError where one isn't a number.
    """
    if len(fields) not in (15, 16):
        raise LogError(f"{line.where}: {len(fields) - 1} numbers after the class, expected 14, or 15 with a score")
    v = {name: parse_number(text, line.where, name) for name, text in zip(_NAMES, fields[1:], strict=False)}
    return make_object(fields[0], v, camera, track_id)


def parse_tracking_row(line: Line, camera: str) -> LabeledObject:
    """Return the object of a row of the tracking benchmark, as `parse_object_row`; its id is -1 where it has none."""
    if len(line.fields) < _NUM_TRACKING:
        raise LogError(f"{line.where}: {len(line.fields)} columns, expected 17, or 18 with a score")
    # Some trackers write more behind the score, which the benchmark's own evaluation doesn't read.
    return parse_object_row(line, line.fields[2:18], camera, max(whole(line.fields[1], line.where, "track id"), -1))


def make_object(name: str, v: Mapping[str, float], camera: str, track_id: int | None) -> LabeledObject:
    """Return the object of a row by its class and numbers; `make_columns` does the same with all rows of a file."""
    dont_care = name == DONT_CARE
    size, place = [v[name] for name in ("height", "width", "length")], [v[name] for name in ("x", "y", "z")]
    flat = (v["left"], v["top"], v["right"], v["bottom"])
    solid = None
    # Results in 2D alone have -1 as sizes, or -1000 as location, or 0 as both: nothing is inside the camera.
    if not dont_care and v["x"] > -1000 and any(value != -1 for value in size) and any(size + place):
        center = (v["z"], -v["x"], v["height"] / 2 - v["y"])
        solid = Solid(center, (v["length"], v["width"], v["height"]), (-v["rotation_y"] - np.pi / 2, 0.0, 0.0))
    occluded, truncated = v.get("occluded", -1), v.get("truncated", -1)
    return LabeledObject(
        name,
        solid,
        Flat(camera, flat) if any(value != -1 for value in flat) else None,
        label="other" if dont_care else None,
        score=v.get("score"),
        track_id=track_id,
        ignore=True if dont_care else None,
        occlusion=None if occluded == -1 else occluded,
        truncation=None if truncated == -1 else truncated,
        alpha_rad=None if v["alpha"] == UNKNOWN_ALPHA else v["alpha"],
    )


def read_tracking_columns(path: Path) -> Columns:
    """Read the file of one sequence; steps are frames, solids as in `parse_object_row`, errors name row and column."""
    try:
        if (plain := parse_plain(read_bytes(path), " ", words=2)) is None:
            return to_columns([], [])
        if plain.width < _NUM_TRACKING:
            raise IrregularError
        score = plain.number(17) if plain.width > _NUM_TRACKING else None
        ids = np.maximum(plain.wholes(1), -1)
        return make_columns(frames_of(plain), ids, *plain.texts(2), plain.numbers(range(3, 17)), score)
    except IrregularError:
        return columns_by_row(path, None, parse_tracking_row)


def read_object_columns(files: Mapping[int, Path]) -> Columns:
    """Read the object benchmark's files, one a frame; steps are frames, errors name row and column."""
    numbers = sorted(files)
    try:
        # All files as one text, because each by itself is small.
        contents = [read_bytes(files[number]).rstrip() for number in numbers]
        if (plain := parse_plain(b"\n".join(contents), " ", words=0)) is None:
            return to_columns([], [])
        num_rows = [content.count(b"\n") + 1 if content else 0 for content in contents]
        frames = np.repeat(np.array(numbers, np.int64), num_rows)
        if not _NUM_OBJECT <= plain.width <= _NUM_OBJECT + 1 or len(plain) != len(frames):
            raise IrregularError
        score = plain.number(_NUM_OBJECT) if plain.width > _NUM_OBJECT else None
        ids = np.full(len(frames), -1)
        return make_columns(frames, ids, *plain.texts(0), plain.numbers(range(1, _NUM_OBJECT)), score)
    except IrregularError:
        return _object_columns_by_row(files)


def _object_columns_by_row(files: Mapping[int, Path]) -> Columns:
    rows = [(number, line) for number in sorted(files) for line in lines(files[number])]
    objects = [parse_object_row(line, line.fields, _COLUMNS_CAMERA, None) for _, line in rows]
    return to_columns([number for number, _ in rows], objects)


def columns_by_row(path: Path, separator: str | None, parse: Callable[[Line, str], LabeledObject]) -> Columns:
    """Read a file of one sequence row by row, which names the row that is wrong."""
    steps, objects = [], []
    for line in lines(path, separator):
        # A frame may be written as 3.0.
        steps.append(frame_number(str(whole(line.fields[0], line.where, "frame")), line.where))
        objects.append(parse(line, _COLUMNS_CAMERA))
    return to_columns(steps, objects)


def frames_of(plain: PlainText) -> Int64:
    """Return the frame (N,) of each row."""
    frames = plain.wholes(0)
    if len(frames) and (frames.min() < 0 or frames.max() >= MAX_FRAMES):
        raise IrregularError
    return frames


def make_columns(
    frames: Int64, ids: Int64, words: Text, which: Int64, numbers: Float64, score: Float64 | None
) -> Columns:
    """Return rows as columns; their classes are `words[which]`, and numbers (N, 14) in the order of `_NAMES`."""
    dont_care: Bool = words[which] == DONT_CARE
    truncated, occluded, alpha, *_, height, width, length, x, y, z, rotation = numbers.T
    has_flat = (numbers[:, 3:7] != -1).any(axis=1)
    has_solid = ~dont_care & (x > -1000) & (numbers[:, 7:10] != -1).any(axis=1) & numbers[:, 7:13].any(axis=1)
    columns: Columns = {
        "step": frames,
        "label": np.array([word.lower() for word in words.tolist()], np.str_)[which],
        "track_id": ids,
        "score": np.zeros(len(frames)) if score is None else score,
        "xyxy_px": np.where(has_flat[:, None], numbers[:, 3:7], np.nan) if has_flat.any() else None,
        "ignore": dont_care if dont_care.any() else None,
    }
    unknown_at = (("alpha_rad", alpha, UNKNOWN_ALPHA), ("truncation", truncated, -1), ("occlusion", occluded, -1))
    for name, values, unknown in unknown_at:
        known = np.where(values == unknown, np.nan, values)
        columns[name] = None if np.isnan(known).all() else known
    if has_solid.any():
        center, size = np.column_stack([z, -x, height / 2 - y]), np.column_stack([length, width, height])
        columns["center_m"] = np.where(has_solid[:, None], center, np.nan)
        columns["size_lwh_m"] = np.where(has_solid[:, None], size, np.nan)
        columns["yaw_rad"] = np.where(has_solid, -rotation - np.pi / 2, np.nan)
    return columns


def open_kitti(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> Iterator[Truth]:
    """Read files named by frame, `label_2/000000.txt` ...; one without rows says that its frame is empty."""
    camera = find_camera(source.camera or source.frame, coordinates, str(source.path))
    files = {frame_number(path.stem, str(path)): path for path in _text_files(source.path, "label_2")}

    def frames() -> Frames:
        for number in sorted(files):
            yield number, [parse_object_row(line, line.fields, camera, None) for line in lines(files[number])]

    return _truths(frames, source, coordinates)


def open_kitti_tracking(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> Iterator[Truth]:
    """Read the file of one sequence; up to the last frame with a row, those without are empty."""
    return _open_sequence(source, coordinates, None, parse_tracking_row)


def _open_sequence(
    source: BoxSource, coordinates: CoordinateFrames, separator: str | None, parse: Callable[[Line, str], LabeledObject]
) -> Iterator[Truth]:
    """Read the boxes of a file, of the only one of a folder, by rows that begin with their frame."""
    camera = find_camera(source.camera or source.frame, coordinates, str(source.path))
    files = _text_files(source.path, "label_02")
    if len(files) > 1:
        named = f"{files[0].name} to {files[-1].name}"
        raise ConfigError(f"{source.path}: {len(files)} sequences, {named}; name one file")

    def frames() -> Frames:
        rows = ((frame_number(line.fields[0], line.where), parse(line, camera)) for line in lines(files[0], separator))
        return fill_frames(group_by_frame(rows))

    return _truths(frames, source, coordinates)


def _text_files(path: Path, inner: str) -> list[Path]:
    """The file itself, or those of a folder or of its subfolder `inner`."""
    if path.is_file():
        return [path]
    folder = path / inner if (path / inner).is_dir() else path
    numbered = (file for file in folder.glob("*.txt") if file.stem.isascii() and file.stem.isdigit())
    if files := sorted(file for file in numbered if file.is_file()):
        return files
    raise LogError(f"{folder}: no file that is named by a number, such as 000000.txt")


def _truths(frames: Callable[[], Frames], source: BoxSource, coordinates: CoordinateFrames) -> Iterator[Truth]:
    where = str(source.path)
    # Of camera 0, whose coordinates KITTI's 3D boxes are in, many logs have no images.
    owner = coordinates.camera(source.frame) or source.frame or find_camera(source.camera, coordinates, where)
    is_solid, body_T_level = any(row.solid is not None for _, objects in frames() for row in objects), np.eye(4)
    if is_solid and (source.frame or not coordinates.camera0_is_body):
        body_T_level = body_T(owner, coordinates, where) @ CAMERA_T_LEVEL
    for number, objects in frames():
        boxes = move_boxes(to_boxes3d(objects), body_T_level) if is_solid else None
        yield Truth(0, 0, boxes, to_boxes2d(objects), number, number)


def parse_ab3dmot_row(line: Line, camera: str) -> LabeledObject:
    """Return the detection of a row, as `parse_object_row`; it has no id. LogError names a missing or wrong column."""
    if len(line.fields) != AB3DMOT_COLUMNS:
        names = ", ".join(("frame", "class", *_AB3DMOT_NAMES))
        raise LogError(f"{line.where}: {len(line.fields)} columns, expected {AB3DMOT_COLUMNS}: {names}")
    kind = whole(line.fields[1], line.where, "class")
    v = {n: parse_number(text, line.where, n) for n, text in zip(_AB3DMOT_NAMES, line.fields[2:], strict=True)}
    return make_object(_AB3DMOT_CLASSES.get(kind, str(kind)), v, camera, None)


def read_ab3dmot_columns(path: Path) -> Columns:
    """Read detections of one sequence; steps are frames. LogError names row and column of what can't be read."""
    try:
        plain = parse_plain(read_bytes(path), ",")
        if plain is None:
            return to_columns([], [])
        if plain.width != AB3DMOT_COLUMNS:
            raise IrregularError
        kinds, which = np.unique(plain.wholes(1), return_inverse=True)
        words = np.array([_AB3DMOT_CLASSES.get(int(kind), str(kind)) for kind in kinds], np.str_)
        unknown = np.full(len(which), -1.0)
        numbers = np.column_stack([unknown, unknown, plain.number(14), plain.numbers((2, 3, 4, 5, *range(7, 14)))])
        return make_columns(frames_of(plain), unknown.astype(np.int64), words, which, numbers, plain.number(6))
    except IrregularError:
        return columns_by_row(path, ",", parse_ab3dmot_row)


def open_ab3dmot(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> Iterator[Truth]:
    """Read detections of one sequence: commas part columns, a row a box, coordinates of KITTI."""
    return _open_sequence(source, coordinates, ",", parse_ab3dmot_row)


def kitti_rows(sequence: BoxSequence, request: ExportRequest, left: LeftOut) -> Iterator[tuple[int, list[str]]]:
    """Yield the number of each frame and its rows; those of the tracking benchmark begin with frame and id.

    Truth that came from KITTI's labels gives the same rows again. Results have truncated and occluded -1 and a score at
    the end. Boxes stand upright in KITTI: of those that are tilted only the heading is kept. Raises ConfigError where a
    camera or coordinate frame isn't known. Raises LogError where boxes have no class, or can't be projected.
    """
    camera = choose_camera(sequence, request.camera)
    frames = image_frames(sequence, camera, left)
    owner, is_tracking = coordinate_frame(sequence, request.frame, camera), request.is_tracking
    name_classes, small_id = namer(request, sequence.where), small_ids(sequence.boxes)
    is_own = sequence.is_truth and sequence.metadata.get("benchmark") == "object"
    digits = 2 if is_own and not is_tracking else 6
    skipped = _IGNORED_TRACKING if is_tracking else _IGNORED_OBJECT
    for number, (frame, found) in zip(sequence.numbers(), frames, strict=True):
        ignored: Bool = found.column("ignore", False) if sequence.is_truth else np.zeros(len(found), bool)
        classes = np.array([DONT_CARE if skip else "" for skip in ignored], dtype=object)
        classes[~ignored] = found[~ignored].names(name_classes)
        kept: Bool = classes != ""
        left["of classes that KITTI doesn't have"] += int(np.count_nonzero(~kept))
        if is_tracking:
            known = ignored | (found.column("track_id", -1) >= 0)
            left["without a track id"] += int(np.count_nonzero(kept & ~known))
            kept &= known
        rows, heads, ignored = found[kept], classes[kept].tolist(), ignored[kept]
        if is_tracking:
            ids = np.where(ignored, -1, rows.column("track_id", -1)).tolist()
            heads = [f"{number} {small_id(id_)} {name}" for id_, name in zip(ids, heads, strict=True)]
        solids = _solids(rows, body_T_level(owner, frame.rig))
        shapes = zip(ignored, _format_rows(solids, digits), strict=True)
        columns = [
            heads,
            _states(rows, ignored, solids, digits, is_tracking=is_tracking, is_truth=sequence.is_truth),
            _format_rows(rows.xyxy_px, digits),
            [skipped if skip else shape for skip, shape in shapes],
        ]
        if not sequence.is_truth:
            scores = rows.column("score", np.nan)
            columns.append(_format_rows(np.where(np.isnan(scores), _SURE, scores)[:, None], 6))
        yield number, [" ".join(parts) for parts in zip(*columns, strict=True)]


def _solids(rows: ImageRows, body_T: Float64 | None) -> Float64:
    """Numbers (N, 7) of 3D boxes: height, width, length, x, y, z, rotation_y."""
    numbers = np.tile(np.array(_UNKNOWN_BOX), (len(rows), 1))
    has = rows.solid_rows >= 0
    boxes = rows.solid[rows.solid_rows[has]]
    if body_T is not None and len(boxes):
        boxes = move_boxes(boxes, inverse(body_T))
    length, width, height = boxes.size_lwh_m.T
    x, y, z = -boxes.center_m[:, 1], height / 2 - boxes.center_m[:, 2], boxes.center_m[:, 0]
    numbers[has] = np.stack([height, width, length, x, y, z, _wrap(-boxes.yaw_rad - np.pi / 2)], axis=1)
    return numbers


def _states(
    rows: ImageRows, ignored: Bool, solids: Float64, digits: int, *, is_tracking: bool, is_truth: bool
) -> list[str]:
    """Truncated, occluded and alpha: the heading as seen from the camera, rotation_y - atan2(x, z)."""
    has_solid = solids[:, 6] != _UNKNOWN_BOX[6]
    seen = np.where(has_solid, _wrap(solids[:, 6] - np.arctan2(solids[:, 3], solids[:, 5])), _UNKNOWN_BOX[6])
    found = _format_rows(seen[:, None], digits)
    if not is_truth:
        return [f"-1 -1 {alpha}" for alpha in found]
    given = [ALPHA.fullmatch(text) for text in rows.column("attribute", "").tolist()]
    alphas = [own if match is None else match[1] for own, match in zip(found, given, strict=True)]
    form = "{:g}" if is_tracking else "{:.2f}"
    truncated = [form.format(v) if np.isfinite(v) else "-1" for v in rows.column("truncation", np.nan).tolist()]
    occluded = [round(value) if abs(value) < 1000 else -1 for value in rows.column("occlusion", np.nan).tolist()]
    unknown = "-1 -1 -10.000000" if is_tracking else "-1 -1 -10"
    columns = zip(ignored, truncated, occluded, alphas, strict=True)
    return [unknown if skip else f"{t} {o} {alpha}" for skip, t, o, alpha in columns]


def _wrap(angles: Float64) -> Float64:
    beyond = np.abs(angles) > np.pi + _MARGIN_RAD
    return np.where(beyond, angles - 2 * np.pi * np.round(angles / (2 * np.pi)), angles)


def _format_rows(values: Float64, digits: int) -> list[str]:
    form = " ".join([f"%.{digits}f"] * values.shape[1])
    texts = [form % tuple(row) for row in values.tolist()]
    return [_ZERO.sub("", text) if "-0." in text else text for text in texts]
