"""Boxes in a table: CSV or Parquet, one row a box. The form is described in docs/formats.md."""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fbench.replay.arrays import Int64
from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.boxfiles.placing import default_camera, placed
from fbench.replay.boxfiles.run_table import is_run_table, read_run_table
from fbench.replay.boxfiles.table_boxes import Rows, Spaces, rows_of, spaces_of
from fbench.replay.boxfiles.table_files import SUFFIXES, TableFile, open_table_file
from fbench.replay.boxfiles.table_order import Key, instants, key_of
from fbench.replay.boxfiles.table_values import Values
from fbench.replay.data import Truth
from fbench.replay.errors import ConfigError, LogError
from fbench.replay.faults import FaultLog
from fbench.replay.logs.coordinates import CoordinateFrames
from fbench.replay.logs.setup import BoxSource
from fbench.replay.truth.labelling import joined


def open_table(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> Iterator[Truth]:
    """Read a table, or all tables of a folder as one.

    Raises:
        ConfigError: where a camera or coordinate frame isn't known, some tables count frames and some have stamps,
            or it is a run folder.
        LogError: naming file, row and column of what can't be read.
    """
    files = [open_table_file(path) for path in _paths(source.path)]
    keys = [key_of(file) for file in files]
    if len({key.is_frame for key in keys}) > 1:
        raise ConfigError(f"{source.path}: some tables count frames and some have stamps; use one of them")
    readers = [_reader(file, key, source, coordinates) for file, key in zip(files, keys, strict=True)]
    together = heapq.merge(*readers, key=_instant)
    return _joined(together, source.path) if len(readers) > 1 else together


@dataclass(frozen=True)
class _Table:
    """How one table is read."""

    file: TableFile
    key: Key
    spaces: Spaces
    source: BoxSource
    coordinates: CoordinateFrames

    def truths(self) -> Iterator[Truth]:
        for keys, values in instants(self.file, self.key):
            rows = rows_of(values, self.spaces, default_camera(self.source, self.coordinates), self.coordinates)
            arrivals = values.wholes("arrival_ns") if "arrival_ns" in values else np.full(len(values), -1)
            yield from self._split(keys, values, rows, arrivals)

    def _split(self, keys: Int64, values: Values, rows: Rows, arrivals: Int64) -> Iterator[Truth]:
        before3d, before2d = (np.concatenate([[0], np.cumsum(has)]) for has in (rows.has_solid, rows.has_flat))
        starts = np.flatnonzero(np.concatenate([[True], np.diff(keys) > 0])) if len(keys) else np.zeros(0, int)
        for start, stop in zip(starts, [*starts[1:], len(keys)], strict=True):
            has_empty = not (rows.has_solid | rows.has_flat)[start:stop].all()
            part3d, part2d = slice(before3d[start], before3d[stop]), slice(before2d[start], before2d[stop])
            boxes3d, in_world = self._solids(rows, part3d, has_empty, values, int(start))
            boxes2d = rows.flats[part2d] if part2d.stop > part2d.start else None
            if boxes2d is None and self.spaces.flat and has_empty:
                boxes2d = Boxes2D.empty()
            yield self._truth(int(keys[start]), int(arrivals[start:stop].max()), boxes3d, boxes2d, in_world)

    def _solids(
        self, rows: Rows, part: slice, has_empty: bool, values: Values, start: int
    ) -> tuple[Boxes3D | None, bool]:
        if part.stop == part.start:
            return (Boxes3D.empty() if self.spaces.solid and has_empty else None), False
        frames = [str(name) or self.source.frame for name in rows.frames[part]]
        return placed(rows.solids[part], frames, self.coordinates, values.where(start))

    def _truth(
        self, key: int, arrival_ns: int, boxes3d: Boxes3D | None, boxes2d: Boxes2D | None, in_world: bool
    ) -> Truth:
        if self.key.is_frame:
            return Truth(0, max(arrival_ns, 0), boxes3d, boxes2d, key, key, in_world)
        return Truth(key, arrival_ns if arrival_ns >= 0 else key, boxes3d, boxes2d, in_world=in_world)


def _reader(file: TableFile, key: Key, source: BoxSource, coordinates: CoordinateFrames) -> Iterator[Truth]:
    if is_run_table(file):
        return read_run_table(file)
    return _Table(file, key, spaces_of(file), source, coordinates).truths()


def _paths(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    if (path / "manifest.json").is_file():
        raise ConfigError(f"{path}: a run folder; give the table that is meant, such as {path / 'detections.parquet'}")
    found = sorted(file for file in path.iterdir() if file.is_file() and file.suffix.lower() in SUFFIXES)
    if not found:
        raise LogError(f"{path}: no .csv and no .parquet in it")
    return found


def _instant(truth: Truth) -> int:
    return truth.stamp_ns if truth.frame_index is None else truth.frame_index


def _joined(truths: Iterator[Truth], where: Path) -> Iterator[Truth]:
    """Put the parts of one instant together that come from several tables."""
    kept: Truth | None = None
    for truth in truths:
        if kept is None or _instant(kept) != _instant(truth):
            if kept is not None:
                yield kept
            kept = truth
            continue
        both = joined(kept, truth)
        if both is None:
            raise LogError(f"{where}: two tables have boxes of one kind at {_instant(truth)}; put them into one table")
        kept = replace(both, in_world=kept.in_world or truth.in_world, log_ns=max(kept.log_ns, truth.log_ns))
    if kept is not None:
        yield kept
