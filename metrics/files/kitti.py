"""KITTI's benchmarks, AB3DMOT's detections and MOTChallenge's files as columns.

Rows, coordinates and what stands for 'unknown' are those of `replay/formats/kitti.py`; solids are at the camera
with x forward, y left, z up.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fbench.metrics.core.sequence import Objects
from fbench.metrics.files.side import nothing, objects_of
from fbench.metrics.files.text_rows import IrregularError, PlainText, columns_of, parse_plain, read_bytes, read_plain
from fbench.replay.data.arrays import Bool, Float64, Int64, Text
from fbench.replay.formats.kitti import (
    AB3DMOT_CLASSES,
    AB3DMOT_COLUMNS,
    DONT_CARE,
    UNKNOWN_ALPHA,
    ab3dmot,
    labelled,
    tracked,
)
from fbench.replay.formats.mot import CLASSES, mot_row
from fbench.replay.formats.objects import MAX_FRAMES, Labelled, Line, frame_number, lines, whole

CAMERA = "image"
_TRACKED = 17
"""Columns without a score: frame, id, class, 14 numbers."""
_OBJECT = 15
"""Class, 14 numbers."""


def read_tracking(path: Path) -> Objects:
    """Return the objects of one sequence; their steps are frames.

    Raises:
        LogError: naming file, row and column of what can't be read.
    """
    try:
        plain = read_plain(path, " ", words=2)
        return nothing() if plain is None else _tracking(plain)
    except IrregularError:
        return read_tracking_rows(path)


def read_tracking_rows(path: Path) -> Objects:
    """Do the same row by row."""
    return _by_row(path, None, lambda line: tracked(line, CAMERA))


def read_ab3dmot(path: Path) -> Objects:
    """Return the detections of one sequence as AB3DMOT takes them; their steps are frames.

    Raises:
        LogError: naming file, row and column of what can't be read.
    """
    try:
        plain = read_plain(path, ",")
        return nothing() if plain is None else _ab3dmot(plain)
    except IrregularError:
        return read_ab3dmot_rows(path)


def read_ab3dmot_rows(path: Path) -> Objects:
    """Do the same row by row."""
    return _by_row(path, ",", lambda line: ab3dmot(line, CAMERA))


def read_images(files: Mapping[int, Path]) -> Objects:
    """Return the objects of the object benchmark's files, one a frame; they have no ids.

    Raises:
        LogError: naming file, row and column of what can't be read.
    """
    try:
        return _images(files)
    except IrregularError:
        return read_images_rows(files)


def read_images_rows(files: Mapping[int, Path]) -> Objects:
    """Do the same row by row."""
    rows = ((number, line) for number in sorted(files) for line in lines(files[number]))
    found = [(number, labelled(line, line.fields, CAMERA, None)) for number, line in rows]
    return columns_of([number for number, _ in found], [row for _, row in found])


def _images(files: Mapping[int, Path]) -> Objects:
    """All files as one text, because each by itself is small."""
    contents = [read_bytes(files[number]).rstrip() for number in sorted(files)]
    plain = parse_plain(b"\n".join(contents), " ", words=0)
    if plain is None:
        return nothing()
    num_rows = [content.count(b"\n") + 1 if content else 0 for content in contents]
    frames = np.repeat(np.array(sorted(files), np.int64), num_rows)
    if not _OBJECT <= plain.width <= _OBJECT + 1 or len(plain) != len(frames):
        raise IrregularError
    score = plain.number(_OBJECT) if plain.width > _OBJECT else None
    words, which = plain.texts(0)
    return _objects(frames, np.full(len(frames), -1), words, which, plain.numbers(range(1, _OBJECT)), score)


def _by_row(path: Path, separator: str | None, read: Callable[[Line], Labelled]) -> Objects:
    found = [(_frame(line), read(line)) for line in lines(path, separator)]
    return columns_of([frame for frame, _ in found], [row for _, row in found])


def _frame(line: Line) -> int:
    """The frame of a row, which may be written as 3.0."""
    return frame_number(str(whole(line.fields[0], line.where, "frame")), line.where)


def _tracking(plain: PlainText) -> Objects:
    if plain.width < _TRACKED:
        raise IrregularError
    words, which = plain.texts(2)
    numbers = plain.numbers(range(3, 17))
    return _objects(
        _frames(plain),
        np.maximum(plain.wholes(1), -1),
        words,
        which,
        numbers,
        plain.number(17) if plain.width > _TRACKED else None,
    )


def _ab3dmot(plain: PlainText) -> Objects:
    """The same numbers in another order: left top right bottom score h w l x y z rotation_y alpha."""
    if plain.width != AB3DMOT_COLUMNS:
        raise IrregularError
    kinds, which = np.unique(plain.wholes(1), return_inverse=True)
    words = np.array([AB3DMOT_CLASSES.get(int(kind), str(kind)) for kind in kinds], np.str_)
    unknown = np.full(len(which), -1.0)
    numbers = np.column_stack([unknown, unknown, plain.number(14), plain.numbers((2, 3, 4, 5, *range(7, 14)))])
    return _objects(_frames(plain), unknown.astype(np.int64), words, which, numbers, plain.number(6))


def _frames(plain: PlainText) -> Int64:
    frames = plain.wholes(0)
    if len(frames) and (frames.min() < 0 or frames.max() >= MAX_FRAMES):
        raise IrregularError
    return frames


def _objects(frames: Int64, ids: Int64, words: Text, which: Int64, numbers: Float64, score: Float64 | None) -> Objects:
    """Numbers (N, 14) are truncated, occluded, alpha, left, top, right, bottom, h, w, l, x, y, z, rotation_y."""
    dont_care = words[which] == DONT_CARE
    columns: dict[str, Any] = {
        "step": frames,
        "label": np.array([word.lower() for word in words.tolist()], np.str_)[which],
        "track_id": ids,
        "score": np.zeros(len(frames)) if score is None else score,
        "xyxy_px": _rectangles(numbers[:, 3:7]),
        "alpha_rad": _known(numbers[:, 2], UNKNOWN_ALPHA),
        "truncation": _known(numbers[:, 0], -1),
        "occlusion": _known(numbers[:, 1], -1),
        "ignore": dont_care if dont_care.any() else None,
        **_solids(numbers, dont_care),
    }
    found, _ = objects_of(columns)
    return found


def _rectangles(numbers: Float64) -> Float64 | None:
    there = (numbers != -1).any(axis=1)
    return np.where(there[:, None], numbers, np.nan) if there.any() else None


def _solids(numbers: Float64, dont_care: Bool) -> dict[str, Float64 | None]:
    height, width, length, x, y, z, rotation = numbers[:, 7:].T
    there = ~dont_care & (x > -1000) & (numbers[:, 7:10] != -1).any(axis=1) & numbers[:, 7:13].any(axis=1)
    if not there.any():
        return {}
    center = np.column_stack([z, -x, height / 2 - y])
    size = np.column_stack([length, width, height])
    return {
        "center_m": np.where(there[:, None], center, np.nan),
        "size_lwh_m": np.where(there[:, None], size, np.nan),
        "yaw_rad": np.where(there, -rotation - np.pi / 2, np.nan),
    }


def _known(values: Float64, unknown: float) -> Float64 | None:
    found = np.where(values == unknown, np.nan, values)
    return None if np.isnan(found).all() else found


_WITH_CLASS = (8, 9)
_WITH_VISIBILITY = 9
_WITH_PLACE = 10


def read_mot(path: Path, is_truth: bool) -> Objects:
    """Return the objects of one sequence; their steps are frames from 0, positions those of the file.

    Raises:
        LogError: naming file, row and column of what can't be read.
    """
    try:
        plain = read_plain(path, ",")
        return nothing() if plain is None else _mot_objects(plain, is_truth)
    except IrregularError:
        return read_mot_rows(path, is_truth)


def read_mot_rows(path: Path, is_truth: bool) -> Objects:
    """Do the same row by row."""
    found = [mot_row(line, CAMERA, is_truth, shift_px=0.0) for line in lines(path, ",")]
    return columns_of([frame - 1 for frame, _ in found], [row for _, row in found])


def _mot_objects(plain: PlainText, is_truth: bool) -> Objects:
    if not 6 <= plain.width <= 10:
        raise IrregularError
    frames = plain.wholes(0)
    if frames.min() < 1 or frames.max() >= MAX_FRAMES:
        raise IrregularError
    left, top, width, height = plain.numbers((2, 3, 4, 5)).T
    has_class = plain.width in _WITH_CLASS
    confidence = plain.number(6) if plain.width > 6 else None
    ignored = np.zeros(len(frames), bool) if confidence is None or not is_truth else np.abs(confidence) < 1
    columns: dict[str, Any] = {
        "step": frames - 1,
        "label": _labels(plain.wholes(7)) if has_class else _labels_among_ten(plain, is_truth),
        "track_id": np.maximum(plain.wholes(1), -1),
        "score": np.zeros(len(frames)) if confidence is None or is_truth else confidence,
        "xyxy_px": np.column_stack([left, top, left + width, top + height]),
        "visibility": plain.number(8) if plain.width == _WITH_VISIBILITY else None,
        "ignore": ignored if ignored.any() else None,
    }
    found, _ = objects_of(columns)
    return found


def _labels(numbers: Int64) -> Text:
    kinds, which = np.unique(numbers, return_inverse=True)
    names = np.array([CLASSES[int(kind)][0] if int(kind) in CLASSES else str(kind) for kind in kinds], np.str_)
    labels: Text = names[which].reshape(len(numbers))
    return labels


def _labels_among_ten(plain: PlainText, is_truth: bool) -> Text:
    """Of rows that have no column for it; see `replay/formats/mot.py`."""
    told = np.ones(len(plain), np.int64)
    if plain.width == _WITH_PLACE and not is_truth:
        told = np.where(np.isin(plain.number(7), list(CLASSES)), plain.number(7), 1).astype(np.int64)
    return _labels(told)
