"""KITTI labels and results: read and write the object and tracking benchmarks' rows.

And the same numbers in another order, comma-separated: detections as AB3DMOT takes them,
https://github.com/xinshuoweng/AB3DMOT.

The inverse of `boxfiles.kitti_rows`.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

import numpy as np

from fbench.replay.contracts.errors import ConfigError, LimitError, LogError, did_you_mean
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Bool, Float64
from fbench.replay.data.messages import Truth
from fbench.replay.data.metadata import CAMERA0
from fbench.replay.data.rig import Rig
from fbench.replay.formats.class_names import namer
from fbench.replay.formats.export_request import ExportWish, LeftOut
from fbench.replay.formats.objects import (
    Flat,
    Labelled,
    Line,
    Solid,
    flats,
    frame_number,
    lines,
    parse_number,
    solids,
    whole,
)
from fbench.replay.formats.placing import body_T, camera_of
from fbench.replay.formats.sequence import BoxSequence, ImageRows, image_rows, require_view, small_ids
from fbench.replay.formats.sequence import camera_of as camera_of_of_sequence
from fbench.replay.geometry.iou import moved
from fbench.replay.geometry.transforms import inverse
from fbench.replay.logs.coordinate_frames import CoordinateFrames
from fbench.replay.logs.setup import BoxSource

DONT_CARE = "DontCare"
CAMERA_T_LEVEL: Float64 = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], np.float64)
"""(4, 4) from a coordinate frame at the camera with x forward, y left, z up: there boxes stand upright. In the camera's
own, with z forward, yaw, pitch and roll of a box that stands upright aren't unique."""
_NAMES = (
    "truncated", "occluded", "alpha", "left", "top", "right", "bottom", "height", "width", "length", "x", "y", "z",
    "rotation_y", "score",
)  # fmt: skip
_AB3DMOT_NAMES = (
    "left", "top", "right", "bottom", "score", "height", "width", "length", "x", "y", "z", "rotation_y", "alpha",
)  # fmt: skip
AB3DMOT_COLUMNS = 2 + len(_AB3DMOT_NAMES)
"""Frame, number of the class, then these."""
UNKNOWN_ALPHA = -10
"""What stands for an angle of observation that nobody knows."""
AB3DMOT_CLASSES = {1: "Pedestrian", 2: "Car", 3: "Cyclist"}


def labelled(line: Line, fields: Sequence[str], camera: str, track_id: int | None) -> Labelled:
    """Return the object of a row, its 3D box at the camera with x forward, y left, z up.

    Location is the middle of the bottom in the camera's coordinates (x right, y down, z forward); `rotation_y` turns
    about y, 0 where the object faces x.

    Args:
        line: For errors.
        fields: Class, then the 14 or 15 numbers.
        camera: Whose image 2D boxes are in.
        track_id: The object's.

    Raises:
        LogError: where a field isn't a number.
    """
    numbers = fields[1:]
    if len(numbers) not in (14, 15):
        raise LogError(f"{line.where}: {len(numbers)} numbers after the class, expected 14, or 15 with a score")
    v = {name: parse_number(text, line.where, name) for name, text in zip(_NAMES, numbers, strict=False)}
    return _object(fields[0], v, camera, track_id)


def ab3dmot(line: Line, camera: str) -> Labelled:
    """Return the detection of a row of AB3DMOT's, its 3D box as in `labelled`; it has no id.

    Raises:
        LogError: where a column is missing or isn't a number.
    """
    if len(line.fields) != AB3DMOT_COLUMNS:
        names = ", ".join(("frame", "class", *_AB3DMOT_NAMES))
        raise LogError(f"{line.where}: {len(line.fields)} columns, expected {AB3DMOT_COLUMNS}: {names}")
    kind = whole(line.fields[1], line.where, "class")
    v = {n: parse_number(text, line.where, n) for n, text in zip(_AB3DMOT_NAMES, line.fields[2:], strict=True)}
    return _object(AB3DMOT_CLASSES.get(kind, str(kind)), v, camera, None)


def _object(name: str, v: Mapping[str, float], camera: str, track_id: int | None) -> Labelled:
    dont_care = name == DONT_CARE
    return Labelled(
        name,
        None if dont_care or not _has_solid(v) else _solid(v),
        Flat(camera, (v["left"], v["top"], v["right"], v["bottom"]))
        if any(v[name] != -1 for name in ("left", "top", "right", "bottom"))
        else None,
        label="other" if dont_care else None,
        score=v.get("score"),
        track_id=track_id,
        ignore=True if dont_care else None,
        occlusion=_known(v.get("occluded", -1)),
        truncation=_known(v.get("truncated", -1)),
        alpha_rad=None if v["alpha"] == UNKNOWN_ALPHA else v["alpha"],
    )


def track_id(text: str, where: str) -> int:
    """Return the id of a row of the tracking benchmark, -1 where it has none."""
    return max(whole(text, where, "track id"), -1)


def _solid(v: Mapping[str, float]) -> Solid:
    center = (v["z"], -v["x"], v["height"] / 2 - v["y"])
    return Solid(center, (v["length"], v["width"], v["height"]), (-v["rotation_y"] - np.pi / 2, 0.0, 0.0))


def _has_solid(v: Mapping[str, float]) -> bool:
    """Results in 2D alone have -1 as sizes, or -1000 as location, or 0 as both: nothing is inside the camera."""
    size, place = [v[name] for name in ("height", "width", "length")], [v[name] for name in ("x", "y", "z")]
    return v["x"] > -1000 and any(value != -1 for value in size) and any(size + place)


def _known(value: float) -> float | None:
    return None if value == -1 else value


_Frames = Iterable[tuple[int, list[Labelled]]]
_MAX_EMPTY = 200_000
"""Frames without rows, one after the other, that still belong to a sequence: nearly two hours."""


def open_kitti(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> Iterator[Truth]:
    """Read a folder of files named by frame, `label_2/000000.txt` ..., or one of them; a file without rows says that
    its frame is empty.

    Raises:
        ConfigError: where the camera isn't known.
        LogError: where a row can't be read.
    """
    camera = _camera(source, coordinates)
    files = {frame_number(path.stem, str(path)): path for path in text_files(source.path, "label_2")}

    def frames() -> _Frames:
        for number in sorted(files):
            yield number, [labelled(line, line.fields, camera, None) for line in lines(files[number])]

    return _truths(frames, source, coordinates)


def open_kitti_tracking(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> Iterator[Truth]:
    """Read the file of one sequence; up to the last frame with a row, those without are empty.

    Raises:
        ConfigError: where the camera isn't known, or the folder has several sequences.
        LogError: where a row can't be read.
    """
    camera, path = _camera(source, coordinates), _only_file(source.path)
    return _truths(lambda: filled(_sequence(path, camera)), source, coordinates)


def open_ab3dmot(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> Iterator[Truth]:
    """Read detections of one sequence as AB3DMOT takes them: comma-separated, a row a box, coordinates those of KITTI.

    Raises:
        ConfigError: where the camera isn't known, or the folder has several sequences.
        LogError: where a row can't be read.
    """
    camera, path = _camera(source, coordinates), _only_file(source.path)

    def rows() -> Iterator[tuple[int, Labelled]]:
        for line in lines(path, ","):
            yield frame_number(line.fields[0], line.where), ab3dmot(line, camera)

    return _truths(lambda: filled(in_order(rows())), source, coordinates)


def filled(frames: _Frames, first: int = 0, num: int = 0) -> _Frames:
    """Put frames without rows between the others, and behind them up to `num` frames.

    Raises:
        LimitError: where these are more than any sequence has.
    """
    expected = first
    for number, objects in frames:
        if number - expected > _MAX_EMPTY:
            raise LimitError(f"frames {expected} to {number - 1} have no row; more than {_MAX_EMPTY} aren't filled in")
        yield from ((i, []) for i in range(expected, number))
        yield number, objects
        expected = number + 1
    yield from ((i, []) for i in range(expected, min(first + num, expected + _MAX_EMPTY)))


def in_order(rows: Iterable[tuple[int, Labelled]]) -> _Frames:
    """Group rows by frame, whatever their order."""
    ordered = sorted(rows, key=lambda row: row[0])
    for number, group in groupby(ordered, key=lambda row: row[0]):
        yield number, [row for _, row in group]


def text_files(path: Path, inner: str) -> list[Path]:
    """Return the file itself, or those of a folder or of its subfolder `inner`.

    Raises:
        LogError: where there are none.
    """
    if path.is_file():
        return [path]
    folder = path / inner if (path / inner).is_dir() else path
    numbered = (file for file in folder.glob("*.txt") if file.stem.isascii() and file.stem.isdigit())
    found = sorted(file for file in numbered if file.is_file())
    if not found:
        raise LogError(f"{folder}: no file that is named by a number, such as 000000.txt")
    return found


def _only_file(path: Path) -> Path:
    files = text_files(path, "label_02")
    if len(files) > 1:
        raise ConfigError(f"{path}: {len(files)} sequences, {files[0].name} to {files[-1].name}; name one file")
    return files[0]


def _camera(source: BoxSource, coordinates: CoordinateFrames) -> str:
    """Whose image 2D boxes are in; 3D boxes are in its coordinates too, unless `frame` names others."""
    return camera_of(source.camera or source.frame, coordinates, str(source.path))


def _sequence(path: Path, camera: str) -> _Frames:
    return in_order((frame_number(line.fields[0], line.where), tracked(line, camera)) for line in lines(path))


def tracked(line: Line, camera: str) -> Labelled:
    """Return the object of a row of the tracking benchmark: frame, id, class and numbers.

    Raises:
        LogError: where a column is missing or isn't a number.
    """
    if len(line.fields) < 17:
        raise LogError(f"{line.where}: {len(line.fields)} columns, expected 17, or 18 with a score")
    # Some trackers write more behind the score, which the benchmark's own evaluation doesn't read.
    return labelled(line, line.fields[2:18], camera, track_id(line.fields[1], line.where))


def _truths(frames: Callable[[], _Frames], source: BoxSource, coordinates: CoordinateFrames) -> Iterator[Truth]:
    where = str(source.path)
    # Of camera 0, whose coordinates KITTI's 3D boxes are in, many logs have no images.
    owner = coordinates.camera(source.frame) or source.frame or camera_of(source.camera, coordinates, where)
    body_T_level = body_T(owner, coordinates, where) @ CAMERA_T_LEVEL
    if coordinates.camera0_is_body and not source.frame:
        body_T_level = np.eye(4)
    is_solid = any(row.solid is not None for _, objects in frames() for row in objects)
    for number, objects in frames():
        yield Truth(
            0, 0, moved(solids(objects), body_T_level) if is_solid else None, flats(objects), number, number
        )  # fmt: skip


BODY = "body"
"""The body's axes, turned: where KITTI's rectified camera 0 is the body, as in its logs."""


def coordinate_frame(sequence: BoxSequence, wished: str, camera: str) -> str:
    """Return `body` or the name of a camera: as asked for, as the log says, else that of the image.

    Raises:
        ConfigError: where it is none of these.
    """
    known = [BODY, *sequence.rig.sensors("camera")]
    name = wished or sequence.metadata.get(CAMERA0, camera)
    if name not in known and any(frame.boxes3d is not None for frame in sequence.frames):
        raise ConfigError(f"{sequence.where}: --frame {name}: neither 'body' nor a camera{did_you_mean(name, known)}")
    return name


def body_T_level(name: str, rig: Rig) -> Float64 | None:
    """Matrix (4, 4) from coordinates at a camera, with x forward, y left, z up, to the body; `None`: they are the same.

    There boxes stand upright, and the camera's own coordinates are these with the axes turned.
    """
    return None if name == BODY or name not in rig.mounts else rig.body_T_sensor(name) @ CAMERA_T_LEVEL


_ALPHA = re.compile(r"alpha=(-?[0-9]{1,4}(?:\.[0-9]{1,9})?)")
"""Attribute of 2D truth: the angle as the label file gave it, which doesn't follow from the box."""
_ZERO = re.compile(r"(?<!\S)-(?=0\.0*(?!\S))")
"""Sign of a number that is rounded to zero."""
_UNKNOWN_BOX = (-1.0, -1.0, -1.0, -1000.0, -1000.0, -1000.0, -10.0)
"""Height, width, length, x, y, z, rotation_y of an object without a 3D box."""
_SURE = 1.0
"""Score of results that have none."""
_MARGIN_RAD = 1e-6
"""Labels with six decimals go so far beyond pi."""


@dataclass(frozen=True)
class _Style:
    """How a benchmark writes its labels, to the letter."""

    digits: int
    ignored: str
    """What follows the 2D box of a region that is ignored."""
    ignored_alpha: str


_TRACKING = _Style(6, " ".join(f"{value:.6f}" for value in (-1000, -1000, -1000, -10, -1, -1, -1)), "-10.000000")
"""The numbers of its ignored regions are in another order than in the object benchmark."""
_OBJECT = _Style(2, "-1 -1 -1 -1000 -1000 -1000 -10", "-10")


def kitti_rows(sequence: BoxSequence, wish: ExportWish, left: LeftOut) -> Iterator[tuple[int, list[str]]]:
    """Yield the number of each frame and its rows; those of the tracking benchmark begin with frame and id.

    Truth that came from KITTI's labels gives the same rows again. Results have truncated and occluded -1 and a score
    at the end. Boxes stand upright in KITTI: of those that are tilted only the heading is kept.

    Raises:
        ConfigError: where a camera or coordinate frame isn't known.
        LogError: where boxes have no class, or can't be projected.
    """
    camera = camera_of_of_sequence(sequence, wish.camera)
    require_view(sequence, camera)
    writer = _Writer(sequence, wish, camera, left)
    for number, frame in zip(sequence.numbers(), sequence.frames, strict=True):
        yield number, writer.texts(number, image_rows(frame, camera, left), frame.rig)


class _Writer:
    """Writes the rows of one sequence."""

    def __init__(self, sequence: BoxSequence, wish: ExportWish, camera: str, left: LeftOut) -> None:
        self._sequence, self._wish, self._left = sequence, wish, left
        self._names = namer(wish, sequence.where)
        self._small = small_ids(sequence.boxes)
        self._owner = coordinate_frame(sequence, wish.frame, camera)
        self._style = _style(sequence, wish)

    def texts(self, number: int, rows: ImageRows, rig: Rig) -> list[str]:
        """Return the rows of a frame."""
        rows, names, ignored = self._named(rows)
        if not len(rows):
            return []
        ids = np.where(ignored, -1, rows.column("track_id", -1)).tolist()
        heads = [f"{number} {self._small(id_)} {name}" for id_, name in zip(ids, names, strict=True)]
        solids = self._solids(rows, rig)
        columns = [
            heads if self._wish.is_tracking else names,
            self._states(rows, ignored, solids),
            _numbers(rows.xyxy_px, self._style.digits),
            [self._style.ignored if skip else text for skip, text in zip(ignored, self._shapes(solids), strict=True)],
        ]
        if not self._sequence.is_truth:
            scores = rows.column("score", np.nan)
            columns.append(_numbers(np.where(np.isnan(scores), _SURE, scores)[:, None], 6))
        return [" ".join(parts) for parts in zip(*columns, strict=True)]

    def _named(self, rows: ImageRows) -> tuple[ImageRows, list[str], Bool]:
        """Leave out what has no class of KITTI or no id, and tell the classes and which regions are ignored."""
        is_truth = self._sequence.is_truth
        ignored: Bool = rows.column("ignore", False) if is_truth else np.zeros(len(rows), bool)
        names = np.array([DONT_CARE if skip else "" for skip in ignored], dtype=object)
        names[~ignored] = rows[~ignored].names(self._names)
        kept: Bool = names != ""
        self._left.add("of classes that KITTI doesn't have", int(np.count_nonzero(~kept)))
        if self._wish.is_tracking:
            known = ignored | (rows.column("track_id", -1) >= 0)
            self._left.add("without a track id", int(np.count_nonzero(kept & ~known)))
            kept &= known
        return rows[kept], names[kept].tolist(), ignored[kept]

    def _solids(self, rows: ImageRows, rig: Rig) -> Float64:
        """Numbers (N, 7) of 3D boxes: height, width, length, x, y, z, rotation_y."""
        numbers = np.tile(np.array(_UNKNOWN_BOX), (len(rows), 1))
        has = rows.solid_rows >= 0
        boxes = rows.solid[rows.solid_rows[has]]
        body_T = body_T_level(self._owner, rig)
        if body_T is not None and len(boxes):
            boxes = moved(boxes, inverse(body_T))
        length, width, height = boxes.size_lwh_m.T
        x, y, z = -boxes.center_m[:, 1], height / 2 - boxes.center_m[:, 2], boxes.center_m[:, 0]
        numbers[has] = np.stack([height, width, length, x, y, z, _wrapped(-boxes.yaw_rad - np.pi / 2)], axis=1)
        return numbers

    def _shapes(self, solids: Float64) -> Sequence[str]:
        return _numbers(solids, self._style.digits)

    def _states(self, rows: ImageRows, ignored: Bool, solids: Float64) -> list[str]:
        """Truncated, occluded and alpha."""
        style, is_truth = self._style, self._sequence.is_truth
        found = _numbers(_alphas(solids)[:, None], style.digits)
        if not is_truth:
            return [f"-1 -1 {alpha}" for alpha in found]
        told = [_ALPHA.fullmatch(text) for text in rows.column("attribute", "").tolist()]
        alphas = [own if match is None else match[1] for own, match in zip(found, told, strict=True)]
        truncated = [_truncated(value, self._wish.is_tracking) for value in rows.column("truncation", np.nan).tolist()]
        occluded = [round(value) if abs(value) < 1000 else -1 for value in rows.column("occlusion", np.nan).tolist()]
        return [
            f"-1 -1 {style.ignored_alpha}" if skip else f"{t} {o} {alpha}"
            for skip, t, o, alpha in zip(ignored, truncated, occluded, alphas, strict=True)
        ]


def _style(sequence: BoxSequence, wish: ExportWish) -> _Style:
    if wish.is_tracking:
        return _TRACKING
    is_own = sequence.is_truth and sequence.metadata.get("benchmark") == "object"
    return _OBJECT if is_own else replace(_OBJECT, digits=6)


def _alphas(solids: Float64) -> Float64:
    """Heading as seen from the camera (N,): rotation_y - atan2(x, z); -10 without a 3D box."""
    known = solids[:, 6] != _UNKNOWN_BOX[6]
    return np.where(known, _wrapped(solids[:, 6] - np.arctan2(solids[:, 3], solids[:, 5])), _UNKNOWN_BOX[6])


def _wrapped(angles: Float64) -> Float64:
    beyond = np.abs(angles) > np.pi + _MARGIN_RAD
    return np.where(beyond, angles - 2 * np.pi * np.round(angles / (2 * np.pi)), angles)


def _truncated(value: float, is_tracking: bool) -> str:
    if not np.isfinite(value):
        return "-1"
    return f"{value:g}" if is_tracking else f"{value:.2f}"


def _numbers(values: Float64, digits: int) -> list[str]:
    """Texts (N,) of the rows of an array."""
    form = " ".join([f"%.{digits}f"] * values.shape[1])
    texts = [form % tuple(row) for row in values.tolist()]
    return [_ZERO.sub("", text) if "-0." in text else text for text in texts]
