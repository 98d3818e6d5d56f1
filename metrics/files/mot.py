"""MOTChallenge's truth and results as columns; pixels count from 1 there, as the files have them."""

from pathlib import Path
from typing import Any

import numpy as np

from fbench.metrics.files.kitti import CAMERA
from fbench.metrics.files.labelled import columns_of
from fbench.metrics.files.plain_text import IrregularError, PlainText, read_plain
from fbench.metrics.files.side import nothing, objects_of
from fbench.metrics.objects import Objects
from fbench.replay.arrays import Int64, Text
from fbench.replay.boxfiles.mot import CLASSES, mot_row
from fbench.replay.boxfiles.text import MAX_FRAMES, lines

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
        return nothing() if plain is None else _objects(plain, is_truth)
    except IrregularError:
        return read_mot_rows(path, is_truth)


def read_mot_rows(path: Path, is_truth: bool) -> Objects:
    """Do the same row by row."""
    found = [mot_row(line, CAMERA, is_truth, shift_px=0.0) for line in lines(path, ",")]
    return columns_of([frame - 1 for frame, _ in found], [row for _, row in found])


def _objects(plain: PlainText, is_truth: bool) -> Objects:
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
    """Of rows that have no column for it; see `replay/boxfiles/mot.py`."""
    told = np.ones(len(plain), np.int64)
    if plain.width == _WITH_PLACE and not is_truth:
        told = np.where(np.isin(plain.number(7), list(CLASSES)), plain.number(7), 1).astype(np.int64)
    return _labels(told)
