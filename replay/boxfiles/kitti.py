"""KITTI's object benchmark (a file a frame) and tracking benchmark (a file a sequence), and AB3DMOT's detections."""

from collections.abc import Callable, Iterable, Iterator
from itertools import groupby
from pathlib import Path

import numpy as np

from fbench.replay.boxfiles.kitti_rows import CAMERA_T_LEVEL, ab3dmot, labelled, track_id
from fbench.replay.boxfiles.placing import body_T, camera_of
from fbench.replay.boxfiles.rows import Labelled, flats, solids
from fbench.replay.boxfiles.text import Line, frame_number, lines
from fbench.replay.data import Truth
from fbench.replay.errors import ConfigError, LimitError, LogError
from fbench.replay.faults import FaultLog
from fbench.replay.geometry.boxes import moved
from fbench.replay.logs.coordinates import CoordinateFrames
from fbench.replay.logs.setup import BoxSource

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
