"""Tables, CSV or Parquet, as columns."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from fbench.metrics.files.side import Side, nothing, objects_of
from fbench.replay.contracts.errors import ConfigError, LimitError, LogError
from fbench.replay.data.arrays import Array, Bool
from fbench.replay.data.rig import Mount, Rig
from fbench.replay.data.sequences import Objects
from fbench.replay.formats.table import is_run_table, rows_of, spaces_of
from fbench.replay.formats.table_files import TableFile, Values, open_table_file
from fbench.replay.logs.coordinate_frames import CoordinateFrames, TransformTree

SEQUENCE = "sequence"
_DEFAULT_CAMERA = "image"
_LEVELS = ("visibility", "occlusion", "truncation")
_MAX_ROWS = 20_000_000  # Rows of one sequence that are taken into memory
_MAX_KEPT = 500_000  # Rows of a table of several sequences up to which it is read once and kept
_SOLID = (("center_m", (3,)), ("size_lwh_m", (3,)), ("yaw_rad", ()), ("velocity_mps", (3,)))
_FLAT = (("xyxy_px", (4,)), ("distance_m", ()), ("range_rate_mps", ()))
_OPTIONAL = ("center_m", "velocity_mps", *(name for name, _ in _FLAT), *_LEVELS, "ignore", "attribute", "num_points")
_IS_UNKNOWN: dict[str, Callable[[Array], Bool]] = {
    "f": np.isnan, "b": np.logical_not, "U": lambda texts: texts == "", "i": lambda nums: nums < 0
}  # fmt: skip
"""Marks values that say nothing, by the kind of their array."""


@dataclass(frozen=True)
class Table:
    """One file, of which sequences are read one by one."""

    file: TableFile
    sequences: tuple[str, ...]  # In the order in which they begin; empty: the file is one
    cameras: tuple[str, ...]

    def read(self, sequence: str = "") -> Side:
        """Return the boxes of one sequence, or of a whole file without a column for it. LogError names row, column."""
        parts = [self._part(values) for values in self._rows(sequence)]
        if not parts:
            return Side(nothing(), has_stamps=not self.file.counts_frames)
        columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        has_solid = ~np.isnan(columns["center_m"]).all(axis=1)
        camera, frames = columns.pop("camera"), np.unique(columns.pop("frame_id")[has_solid])
        if len(frames) > 1:
            raise ConfigError(f"{self.file.path}: boxes in '{frames[0]}' and '{frames[1]}'; scoring needs one frame_id")
        there = columns.pop("there")
        keys = np.unique(columns["step"])
        objects, order = objects_of({name: column[there] for name, column in columns.items()})
        return Side(
            _slim(objects),
            # With stamps, or with rows for empty frames, the table says which frames there are.
            keys if not self.file.counts_frames or not there.all() else None,
            not self.file.counts_frames,
            camera=camera[there][order],
            space=str(frames[0]) if len(frames) else "",
        )

    @cached_property
    def _small(self) -> dict[str, pa.Table] | None:
        """Rows by sequence of a table so small that it is read once; `None`: each sequence is read from all of it."""
        parts: dict[str, list[pa.Table]] = {}
        num = 0
        for batch in self.file.batches():
            num += batch.num_rows
            if num > _MAX_KEPT:
                return None
            names = Values(self.file.path, batch).texts(SEQUENCE)
            for name in np.unique(names).tolist():
                parts.setdefault(name, []).append(batch.filter(pa.array(names == name)))
        return {name: pa.concat_tables(own) for name, own in parts.items()}

    def _rows(self, sequence: str) -> Iterator[Values]:
        if self.sequences and self._small is not None:
            yield Values(self.file.path, self._small[sequence])
            return
        num = 0
        for batch in self.file.batches():
            values = Values(self.file.path, batch)
            if self.sequences:
                values = Values(self.file.path, batch.filter(pa.array(values.texts(SEQUENCE) == sequence)))
            if len(values):
                num += len(values)
                if num > _MAX_ROWS:
                    raise LimitError(f"{self.file.path}: one sequence has more than {_MAX_ROWS} rows")
                yield values

    def _part(self, values: Values) -> dict[str, Array]:
        rows, size = rows_of(values, spaces_of(self.file), _DEFAULT_CAMERA, self._coordinates), len(values)
        unknown, no_text = np.full(size, np.nan), np.full(size, "", "U1")
        numbers, is_there = values.numbers("score") if "score" in values else (unknown, np.zeros(size, bool))
        labels = [text.lower() for text in values.texts("label").tolist()] if "label" in values else []
        has_camera = rows.has_flat.any() and bool(self.cameras)
        return {
            "step": values.keys(self.file.key),
            "label": np.array(labels, np.str_) if "label" in values else no_text,
            "track_id": values.ids("track_id") if "track_id" in values else np.full(size, -1, np.int64),
            "score": np.where(is_there, numbers, 0.0),  # one that isn't finite stays so
            "there": rows.has_solid | rows.has_flat,
            "camera": _spread(rows.flats.camera, rows.has_flat, "") if has_camera else no_text,
            "frame_id": _spread(rows.frames, rows.has_solid, ""),
            **{name: values.numbers(name)[0] if name in values else unknown for name in _LEVELS},
            "ignore": values.flags("ignore") if "ignore" in values else np.zeros(size, bool),
            "attribute": values.texts("attribute") if "attribute" in values else no_text,
            "num_points": _num_points(values),
            **{name: _spread(getattr(rows.solids, name), rows.has_solid, np.nan, shape) for name, shape in _SOLID},
            **{name: _spread(getattr(rows.flats, name), rows.has_flat, np.nan, shape) for name, shape in _FLAT},
        }

    @cached_property
    def _coordinates(self) -> CoordinateFrames:
        """Cameras are what the table calls so."""
        mount = Mount("camera", np.zeros(3), np.array([0.0, 0, 0, 1]))
        rig = Rig(dict.fromkeys((*self.cameras, _DEFAULT_CAMERA), mount), {})
        return CoordinateFrames(rig, TransformTree(), "body")


def open_table(path: Path) -> Table:
    """Open a table and find its sequences and cameras. ConfigError for one of a run folder, LogError if of no boxes."""
    file = open_table_file(path)
    if is_run_table(file):
        raise ConfigError(f"{path}: a table of a run folder; score the folder: fbench score {path.parent}")
    spaces_of(file)
    _ = file.key  # refuses a table that doesn't say when its boxes were
    return Table(file, _distinct(file, SEQUENCE), _distinct(file, "camera"))


def _distinct(file: TableFile, column: str) -> tuple[str, ...]:
    """Different texts of a column in the order in which they come."""
    found: dict[str, None] = {}
    for batch in file.batches([column]) if column in file.names else ():
        names, first = np.unique(Values(file.path, batch).texts(column), return_index=True)
        found |= dict.fromkeys(names[np.argsort(first)].tolist())
    if column == SEQUENCE and "" in found:
        raise LogError(f"{file.path}: a row without sequence")
    return tuple(name for name in found if name)


def _spread(some: Array | None, rows: Bool, absent: Any, shape: tuple[int, ...] = ()) -> Array:
    """Values of some rows among all; the others have `absent`, and all where there are none, of this shape."""
    if some is None:
        return np.full((len(rows), *shape), absent)
    found = np.full((len(rows), *some.shape[1:]), absent, some.dtype)
    found[rows] = some
    return found


def _num_points(values: Values) -> Array:
    """Points of all sensors that say how many (N,), -1 where none does."""
    points = [np.maximum(values.wholes(f"num_{s}_pts"), -1) for s in ("lidar", "radar") if f"num_{s}_pts" in values]
    if not points:
        return np.full(len(values), -1, np.int64)
    return np.where(np.max(points, axis=0) < 0, -1, np.maximum(points, 0).sum(axis=0))


def _slim(objects: Objects) -> Objects:
    """Leave out columns in which nothing is known."""
    if not len(objects):
        return nothing()
    columns = {name: getattr(objects, name) for name in _OPTIONAL}
    unknown = [name for name, column in columns.items() if _IS_UNKNOWN[column.dtype.kind](column).all()]
    absent: dict[str, Any] = dict.fromkeys(unknown)
    if "center_m" in absent:
        absent |= {"size_lwh_m": None, "yaw_rad": None}
    return replace(objects, **absent)
