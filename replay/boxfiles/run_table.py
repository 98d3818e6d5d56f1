"""Tables of run folders, `detections.parquet` and the like, as boxes."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.boxfiles.table_files import TableFile
from fbench.replay.boxfiles.table_order import Key, instants
from fbench.replay.data import Truth
from fbench.replay.tables import column_array

_KINDS: Mapping[bytes, type[Boxes2D] | type[Boxes3D]] = {b"Boxes3D": Boxes3D, b"Boxes2D": Boxes2D}


def is_run_table(file: TableFile) -> bool:
    """Tell whether a file is a table of boxes that fbench wrote."""
    kind = _KINDS.get(file.metadata.get(b"boxes", b""))
    return kind is not None and set(file.names) == {"frame", *(f.name.lower() for f in fields(kind))}


def read_run_table(file: TableFile) -> Iterator[Truth]:
    """Read boxes by the index of their frame; frames without boxes aren't in the table.

    Raises:
        LogError: where the file is damaged.
    """
    kind = _KINDS[file.metadata[b"boxes"]]
    for keys, values in instants(file, Key("frame")):
        columns = {f.name: values.table.column(f.name.lower()) for f in fields(kind)}
        arrays: dict[str, Any] = {n: column_array(c) for n, c in columns.items() if c.null_count < len(values)}
        boxes = replace(Boxes3D.empty(), **arrays) if kind is Boxes3D else replace(Boxes2D.empty(), **arrays)
        starts = np.flatnonzero(np.concatenate([[True], np.diff(keys) > 0]))
        for start, stop in zip(starts, [*starts[1:], len(keys)], strict=True):
            part = boxes[start:stop]
            solid, flat = (part, None) if isinstance(part, Boxes3D) else (None, part)
            yield Truth(0, 0, solid, flat, frame_index=int(keys[start]))
