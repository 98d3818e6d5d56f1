"""Tables of boxes, CSV or Parquet, one row a box; also those of run folders."""

import heapq
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from fbench.replay.contracts.errors import ConfigError, LogError, did_you_mean
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.classes import label
from fbench.replay.data.messages import Truth
from fbench.replay.formats.objects import angles, default_camera, find_camera, place
from fbench.replay.formats.recognition import SUFFIXES
from fbench.replay.formats.table_files import TableFile, Values, instants, open_table_file
from fbench.replay.logs.coordinate_frames import CoordinateFrames
from fbench.replay.logs.setup import BoxSource
from fbench.replay.runs.columns import column_array
from fbench.replay.runs.tables import box_schema
from fbench.replay.truth.labelling import join_truths

SOLID = ("x", "y", "z", "length", "width", "height")
FLAT = ("left", "top", "right", "bottom")
_QUATERNION = ("qx", "qy", "qz", "qw")
_VELOCITY = ("vx", "vy", "vz")
_ANGLES = ("yaw", "pitch", "roll")
_FLOATS = ("score", "visibility", "occlusion", "truncation")
_FLAT_FLOATS = ("distance_m", "range_rate_mps")
_WHOLES = ("num_lidar_pts", "num_radar_pts")
COLUMNS = (
    "stamp_ns", "stamp_s", "frame", "frame_id", *SOLID, *_ANGLES, "yaw_deg", *_QUATERNION, *_VELOCITY, "camera", *FLAT,
    "label", *_FLOATS, "track_id", "ignore", "attribute", *_WHOLES, *_FLAT_FLOATS, "arrival_ns",
)  # fmt: skip
_KINDS: Mapping[bytes, type[Boxes2D] | type[Boxes3D]] = {b"Boxes3D": Boxes3D, b"Boxes2D": Boxes2D}


@dataclass(frozen=True, eq=False)
class Rows:
    """Which of N rows have a box, and these boxes."""

    has_solid: Bool
    solids: Boxes3D  # (sum of `has_solid`), each in its own coordinate frame
    frames: Array  # Names of these
    has_flat: Bool
    flats: Boxes2D


def spaces_of(file: TableFile) -> tuple[bool, bool]:
    """Tell whether a table's columns hold 3D boxes, and 2D ones. LogError names a missing or misspelt column."""
    names = file.names
    has_solid, has_flat = (any(name in names for name in needed) for needed in (SOLID, FLAT))
    if not (has_solid or has_flat):
        raise LogError(f"{file.path}: no columns of boxes; expected {' '.join(SOLID)} yaw, or {' '.join(FLAT)}")
    for missing in (*(SOLID if has_solid else ()), *(FLAT if has_flat else ())):
        if missing not in names:
            hint = did_you_mean(missing, [name for name in names if name not in COLUMNS])
            hint = hint if "did you mean" in hint else f"; there are: {', '.join(names)}"
            raise LogError(f"{file.path}: column '{missing}' is missing{hint}")
    if has_solid and not ({"yaw", "yaw_deg"} & set(names) or set(_QUATERNION) <= set(names)):
        raise LogError(f"{file.path}: column 'yaw' is missing (or yaw_deg, or qx qy qz qw)")
    for name in names:
        near = did_you_mean(name, COLUMNS) if name not in COLUMNS and len(name) > 4 else ""
        meant = near.partition("did you mean '")[2].rstrip("?").rstrip("'")
        if meant and meant not in names and _is_slip(name, meant):
            raise LogError(f"{file.path}: column '{name}' isn't known{near}")
    return has_solid, has_flat


def rows_of(values: Values, spaces: tuple[bool, bool], camera: str, coordinates: CoordinateFrames) -> Rows:
    """Read boxes of a table that has the kinds of `spaces_of`; 2D ones are in the image of `camera`, where it doesn't
    say. Raises ConfigError where a camera isn't known, LogError naming row and column of what can't be read.
    """
    has_solid, has_flat = (
        _find_boxes(values, names) if is_there else np.zeros(len(values), bool)
        for names, is_there in zip((SOLID, FLAT), spaces, strict=True)
    )
    common = _common(values)
    frames = values.texts("frame_id") if "frame_id" in values else np.full(len(values), "")
    solids = _solids(values, has_solid, common) if has_solid.any() else Boxes3D.empty()
    flats = _flats(values, has_flat, common, camera, coordinates) if has_flat.any() else Boxes2D.empty()
    return Rows(has_solid, solids, frames[has_solid], has_flat, flats)


def _find_boxes(values: Values, names: Sequence[str]) -> Bool:
    """Tell which rows have a box; one that has only a part of it is refused, one of NaN alone has none."""
    numbers, filled = (np.stack(columns, axis=1) for columns in zip(*map(values.numbers, names), strict=True))
    filled &= ~np.isnan(numbers).all(axis=1, keepdims=True)
    there: Bool = np.all(filled, axis=1)
    partly: Bool = np.any(filled, axis=1) & ~there
    if partly.any():
        row = int(np.argmax(partly))
        raise LogError(f"{values.where(row)}: {names[int(np.argmin(filled[row]))]} is empty, though the row has a box")
    return there


def _stack(values: Values, names: Sequence[str], rows: Bool) -> Float64:
    return np.stack([values.numbers(name)[0][rows] for name in names], axis=1)


def _solids(values: Values, rows: Bool, common: dict[str, Array]) -> Boxes3D:
    box = _stack(values, SOLID, rows)
    turn = _angles_of(values, rows)
    velocity = None
    if "vx" in values and "vy" in values:
        velocity = _stack(values, _VELOCITY if "vz" in values else _VELOCITY[:2], rows)
        unknown = np.isnan(velocity[:, :2]).any(axis=1)
        velocity = np.pad(velocity, ((0, 0), (0, 3 - velocity.shape[1])))
        velocity[:, 2] = np.where(np.isnan(velocity[:, 2]), 0.0, velocity[:, 2])
        velocity[unknown] = np.nan
    chosen: dict[str, Any] = {name: column[rows] for name, column in common.items()}
    if np.any(turn[:, 1:]):
        chosen |= {"pitch_rad": turn[:, 1], "roll_rad": turn[:, 2]}
    return Boxes3D(box[:, :3], box[:, 3:], turn[:, 0], velocity_mps=velocity, **chosen)


def _angles_of(values: Values, rows: Bool) -> Float64:
    """Yaw, pitch, roll (N, 3)."""
    if all(name in values for name in _QUATERNION):
        quaternions = zip(_stack(values, _QUATERNION, rows).tolist(), np.flatnonzero(rows).tolist(), strict=True)
        return np.array([angles(x, y, z, w, values.where(i)) for (x, y, z, w), i in quaternions])
    turn = np.zeros((int(rows.sum()), 3))
    for i, name in enumerate(_ANGLES):
        column = "yaw_deg" if name == "yaw" and "yaw" not in values else name
        if column in values:
            numbers, there = values.numbers(column)
            turn[:, i] = np.where(there, np.deg2rad(numbers) if column == "yaw_deg" else numbers, 0.0)[rows]
            if name == "yaw" and not there[rows].all():
                row = int(np.argmax(rows & ~there))
                raise LogError(f"{values.where(row)}: {column} is empty, though the row has a box")
    return turn


def _flats(values: Values, rows: Bool, common: dict[str, Array], camera: str, coordinates: CoordinateFrames) -> Boxes2D:
    named = values.texts("camera")[rows] if "camera" in values else np.full(int(rows.sum()), "")
    at = values.where(int(np.argmax(rows)))
    known = {name: find_camera(str(name) or camera, coordinates, at) for name in np.unique(named)}
    chosen: dict[str, Any] = {name: column[rows] for name, column in common.items()}
    chosen |= {name: values.numbers(name)[0][rows] for name in _FLAT_FLOATS if name in values}
    cameras = np.array([known[name] for name in named], np.str_)
    return Boxes2D(cameras, _stack(values, FLAT, rows), **chosen)


def _common(values: Values) -> dict[str, Array]:
    columns: dict[str, Array] = {name: values.numbers(name)[0] for name in _FLOATS if name in values}
    columns |= {name: values.wholes(name) for name in _WHOLES if name in values}
    if "label" in values:
        names = values.texts("label")
        known = {name: label(str(name)) for name in np.unique(names)}
        columns["label"] = np.array([known[name] for name in names], np.str_)
        columns["source_label"] = names
    readers = {"track_id": values.ids, "ignore": values.flags, "attribute": values.texts}
    return columns | {name: read(name) for name, read in readers.items() if name in values}


def _is_slip(name: str, meant: str) -> bool:
    """Whether the names differ in dashes, blanks or one letter at most."""
    plain = [text.replace("_", "").replace("-", "").replace(" ", "") for text in (name, meant)]
    return plain[0] == plain[1] or (abs(len(name) - len(meant)) <= 1 and sorted(name)[:-1] == sorted(meant)[:-1])


def is_run_table(file: TableFile) -> bool:
    """Tell whether a file is a table of boxes that fbench wrote."""
    kind = _KINDS.get(file.metadata.get(b"boxes", b""))
    return kind is not None and set(file.names) == {"frame", *(f.name.lower() for f in fields(kind))}


def read_run_table(file: TableFile) -> Iterator[Truth]:
    """Read boxes by the index of their frame; frames without any aren't in the table. Raises LogError if damaged."""
    kind = _KINDS[file.metadata[b"boxes"]]
    for column in box_schema(kind):
        if not _can_hold(given := file.types[column.name.lower()], column.type):
            raise LogError(f"{file.path}: column '{column.name}' is {given}, expected {column.type}")
    for keys, values in instants(file):
        columns = {f.name: values.table.column(f.name.lower()) for f in fields(kind)}
        arrays: dict[str, Any] = {n: column_array(c) for n, c in columns.items() if c.null_count < len(values)}
        boxes = replace(Boxes3D.empty(), **arrays) if kind is Boxes3D else replace(Boxes2D.empty(), **arrays)
        for start, stop in _runs(keys):
            part = boxes[start:stop]
            solid, flat = (part, None) if isinstance(part, Boxes3D) else (None, part)
            yield Truth(0, 0, solid, flat, frame_index=int(keys[start]))


def _can_hold(given: pa.DataType, wanted: pa.DataType) -> bool:
    """Tell whether a column of another program's table can be read as one that fbench wrote."""
    plain = given.value_type if pa.types.is_dictionary(given) else given
    are_alike = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, _is_text)
    return pa.types.is_null(plain) or plain == wanted or any(is_so(plain) and is_so(wanted) for is_so in are_alike)


def _is_text(kind: pa.DataType) -> bool:
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _runs(keys: Int64) -> Iterator[tuple[int, int]]:
    """First row, and the one behind the last, of each different key; keys ascend."""
    starts = np.unique(keys, return_index=True)[1].tolist()
    return zip(starts, [*starts[1:], len(keys)], strict=True) if starts else iter(())


def open_table(source: BoxSource, coordinates: CoordinateFrames, faults: FaultLog) -> Iterator[Truth]:
    """Read a table, or all tables of a folder as one. ConfigError where a camera or coordinate frame isn't known, or
    tables differ in whether they count frames, or for a run folder; LogError names file, row and column.
    """
    paths = [source.path]
    if not source.path.is_file():
        if (source.path / "manifest.json").is_file():
            example = source.path / "detections.parquet"
            raise ConfigError(f"{source.path}: a run folder; give the table that is meant, such as {example}")
        paths = sorted(path for path in source.path.iterdir() if path.is_file() and path.suffix.lower() in SUFFIXES)
        if not paths:
            raise LogError(f"{source.path}: no .csv, .parquet or .feather in it")
    files = [open_table_file(path) for path in paths]
    if len({file.counts_frames for file in files}) > 1:
        raise ConfigError(f"{source.path}: some tables count frames and some have stamps; use one of them")
    readers = [
        read_run_table(file) if is_run_table(file) else _Table(file, spaces_of(file), source, coordinates).truths()
        for file in files
    ]
    together = heapq.merge(*readers, key=_instant)
    return _join(together, source.path) if len(readers) > 1 else together


@dataclass(frozen=True)
class _Table:
    """How one table is read."""

    file: TableFile
    spaces: tuple[bool, bool]
    source: BoxSource
    coordinates: CoordinateFrames

    def truths(self) -> Iterator[Truth]:
        camera = default_camera(self.source, self.coordinates)
        for keys, values in instants(self.file):
            rows = rows_of(values, self.spaces, camera, self.coordinates)
            arrivals = values.wholes("arrival_ns") if "arrival_ns" in values else np.full(len(values), -1)
            before3d, before2d = (np.concatenate([[0], np.cumsum(has)]) for has in (rows.has_solid, rows.has_flat))
            for start, stop in _runs(keys):
                solids = rows.solids[before3d[start] : before3d[stop]]
                flats = rows.flats[before2d[start] : before2d[stop]]
                # A row without a box says that nothing is there.
                has_empty = not (rows.has_solid | rows.has_flat)[start:stop].all()
                boxes3d, in_world = None, False
                if len(solids):
                    frames = rows.frames[before3d[start] : before3d[stop]]
                    names = [str(name) or self.source.frame for name in frames]
                    boxes3d, in_world = place(solids, names, self.coordinates, values.where(start))
                elif self.spaces[0] and has_empty:
                    boxes3d = Boxes3D.empty()
                boxes2d = flats if len(flats) else Boxes2D.empty() if self.spaces[1] and has_empty else None
                key, arrival_ns = int(keys[start]), int(arrivals[start:stop].max())
                if self.file.counts_frames:
                    yield Truth(0, max(arrival_ns, 0), boxes3d, boxes2d, key, key, in_world)
                else:
                    yield Truth(key, arrival_ns if arrival_ns >= 0 else key, boxes3d, boxes2d, in_world=in_world)


def _instant(truth: Truth) -> int:
    return truth.stamp_ns if truth.frame_index is None else truth.frame_index


def _join(truths: Iterator[Truth], where: Path) -> Iterator[Truth]:
    """Put the parts of one instant together that come from several tables."""
    kept: Truth | None = None
    for truth in truths:
        if kept is None or _instant(kept) != _instant(truth):
            if kept is not None:
                yield kept
            kept = truth
            continue
        both = join_truths(kept, truth)
        if both is None:
            raise LogError(f"{where}: two tables have boxes of one kind at {_instant(truth)}; put them into one table")
        kept = replace(both, in_world=kept.in_world or truth.in_world, log_ns=max(kept.log_ns, truth.log_ns))
    if kept is not None:
        yield kept
