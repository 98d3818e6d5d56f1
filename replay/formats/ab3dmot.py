"""Detections as AB3DMOT takes them (https://github.com/xinshuoweng/AB3DMOT): KITTI's numbers in another order.

A row is `frame,class,left,top,right,bottom,score,height,width,length,x,y,z,rotation_y,alpha`.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import Truth
from fbench.replay.formats.bulk_text import IrregularError, read_plain
from fbench.replay.formats.kitti import columns_by_row, frames_of, make_columns, make_object, open_sequence
from fbench.replay.formats.objects import Columns, LabeledObject, to_columns
from fbench.replay.formats.text import Line, parse_number, whole
from fbench.replay.logs.coordinate_frames import CoordinateFrames
from fbench.replay.logs.setup import BoxSource

_NAMES = (
    "left", "top", "right", "bottom", "score", "height", "width", "length", "x", "y", "z", "rotation_y", "alpha",
)  # fmt: skip
AB3DMOT_COLUMNS = 2 + len(_NAMES)  # Frame, number of the class, then these
_CLASSES = {1: "Pedestrian", 2: "Car", 3: "Cyclist"}


def parse_ab3dmot_row(line: Line, camera: str) -> LabeledObject:
    """Return the detection of a row, as `parse_object_row`; it has no id. LogError names a missing or wrong column."""
    if len(line.fields) != AB3DMOT_COLUMNS:
        names = ", ".join(("frame", "class", *_NAMES))
        raise LogError(f"{line.where}: {len(line.fields)} columns, expected {AB3DMOT_COLUMNS}: {names}")
    kind = whole(line.fields[1], line.where, "class")
    v = {n: parse_number(text, line.where, n) for n, text in zip(_NAMES, line.fields[2:], strict=True)}
    return make_object(_CLASSES.get(kind, str(kind)), v, camera, None)


def read_ab3dmot_columns(path: Path) -> Columns:
    """Read detections of one sequence; steps are frames. LogError names row and column of what can't be read."""
    try:
        plain = read_plain(path, ",")
        if plain is None:
            return to_columns([], [])
        if plain.width != AB3DMOT_COLUMNS:
            raise IrregularError
        kinds, which = np.unique(plain.wholes(1), return_inverse=True)
        words = np.array([_CLASSES.get(int(kind), str(kind)) for kind in kinds], np.str_)
        unknown = np.full(len(which), -1.0)
        numbers = np.column_stack([unknown, unknown, plain.number(14), plain.numbers((2, 3, 4, 5, *range(7, 14)))])
        return make_columns(frames_of(plain), unknown.astype(np.int64), words, which, numbers, plain.number(6))
    except IrregularError:
        return columns_by_row(path, ",", parse_ab3dmot_row)


def open_ab3dmot(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> Iterator[Truth]:
    """Read detections of one sequence: comma-separated, a row a box, coordinates those of KITTI. Raises as
    `open_sequence`.
    """
    return open_sequence(source, coordinates, ",", parse_ab3dmot_row)
