"""Objects with a rectangle, a solid or both, from the boxes of frames.

of fbench. The tables are those by which boxes are exported.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal, TypeVar

import numpy as np

from fbench.metrics.core.sequence import Objects
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, Text, text_array
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.formats.export_request import TABLES, ClassTable
from fbench.replay.formats.sequence import ImageRows

Family = Literal["kitti-tracking", "mot", "nuscenes", "nuscenes-tracking"]
"""Benchmarks with one set of classes, called as the formats of `fbench log export`."""
RACK = "static_object.bicycle_rack"  # nuScenes' truth tells where bicycles stand that don't count
_REGIONS = {"kitti-tracking": "dontcare", "mot": "distractor"}
"""What truth that is to be ignored is called, where a flag doesn't do."""


def names_of(family: Family | None, source_labels: Text, labels: Text, ignored: Bool) -> Text:
    """Return the benchmark's name (N,) of each box in lower case; empty where it has none, or the box has no class.

    Args:
        family: Of the benchmark; `None`: the source's own words, else fbench's.
        source_labels: (N,) as the source names classes; empty where it doesn't.
        labels: (N,) of fbench.
        ignored: (N,) truth that is neither a hit nor a miss.
    """
    if not len(labels):
        return np.zeros(0, "U1")
    if family is None:
        return text_array([own.lower() or label for own, label in zip(source_labels, labels, strict=True)])
    table, region = TABLES[family], _REGIONS.get(family, "")
    triples = list(zip(source_labels.tolist(), labels.tolist(), ignored.tolist(), strict=True))
    known = {triple: _name(table, region, *triple) for triple in dict.fromkeys(triples)}
    return text_array([known[triple] for triple in triples])


def _name(table: ClassTable, region: str, source_label: str, label: str, is_ignored: bool) -> str:
    # A word of MOTChallenge says by itself whether it excuses what is found there; KITTI has but one for all regions.
    if is_ignored and region and (region == "dontcare" or source_label not in table.own):
        return region
    if source_label == RACK:
        return RACK
    return (table.name(source_label, label) or "").lower()


B = TypeVar("B", Boxes2D, Boxes3D)
_UNKNOWN = {"f": np.nan, "i": -1, "u": 0, "b": False, "U": ""}
"""What stands for 'unknown' where a frame lacks what others have."""


def stacked(parts: Sequence[B], nothing: B) -> B:
    """Join boxes one after the other; what only some tell is unknown in the others."""
    full = [part for part in parts if len(part)]
    if not full:
        return nothing
    joined: dict[str, Any] = {}
    for own in fields(full[0]):
        columns = [getattr(part, own.name) for part in full]
        example = next((column for column in columns if column is not None), None)
        if example is not None:
            joined[own.name] = np.concatenate([
                _unknown(len(part), example) if column is None else column
                for part, column in zip(full, columns, strict=True)
            ])  # fmt: skip
    return type(nothing)(**joined)


def _unknown(num: int, like: Array) -> Array:
    return np.full((num, *like.shape[1:]), _UNKNOWN[like.dtype.kind], like.dtype)


def twins(flat_frame: Int64, flat: Boxes2D, solid_frame: Int64, solid: Boxes3D) -> Int64:
    """Return the 3D box (N,) of each 2D box, -1 where it has none, as `export.pairs.paired` does frame by frame.

    Boxes of one track id belong together. Those without an id do in their order, within a class as the source names it;
    what is to be ignored has no other half.

    Args:
        flat_frame: (N,) frame of each 2D box.
        flat: Of one camera.
        solid_frame: (M,)
        solid: The 3D boxes.
    """
    found = np.full(len(flat), -1, np.int64)
    ids = _ids(flat), _ids(solid)
    named = ids[0] >= 0, ids[1] >= 0
    _pair(found, named, (flat_frame, ids[0]), (solid_frame, ids[1]))
    free = ~named[0] & ~_ignored(flat), ~named[1] & ~_ignored(solid)
    codes = np.unique(np.concatenate([_classes(flat), _classes(solid)]), return_inverse=True)[1]
    keys = np.column_stack([flat_frame, codes[: len(flat)]]), np.column_stack([solid_frame, codes[len(flat) :]])
    places = [_places(own, rows) for own, rows in zip(keys, free, strict=True)]
    _pair(found, free, (*keys[0].T, places[0]), (*keys[1].T, places[1]))
    return found


def _pair(found: Int64, rows: tuple[Bool, Bool], flat_keys: tuple[Array, ...], solid_keys: tuple[Array, ...]) -> None:
    """Give those rows of `found` the 3D box with the same key."""
    flat, solid = np.flatnonzero(rows[0]), np.flatnonzero(rows[1])
    if not len(flat) or not len(solid):
        return
    keys = np.concatenate([np.column_stack(flat_keys)[flat], np.column_stack(solid_keys)[solid]])
    number = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
    row_of = np.full(int(number.max()) + 1, -1, np.int64)
    row_of[number[len(flat) :]] = solid
    found[flat] = row_of[number[: len(flat)]]


def _places(keys: Int64, rows: Bool) -> Int64:
    """How many rows with the same key (N, 2) come before each of these rows."""
    place = np.zeros(len(keys), np.int64)
    if rows.any():
        number = np.unique(keys[rows], axis=0, return_inverse=True)[1].reshape(-1)
        order = np.argsort(number, kind="stable")
        sizes = np.bincount(number)
        own = np.empty(len(number), np.int64)
        own[order] = np.arange(len(number)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        place[rows] = own
    return place


def _ids(boxes: Boxes2D | Boxes3D) -> Int64:
    return np.full(len(boxes), -1, np.int64) if boxes.track_id is None else boxes.track_id


def _ignored(boxes: Boxes2D | Boxes3D) -> Bool:
    return np.zeros(len(boxes), bool) if boxes.ignore is None else boxes.ignore


def _classes(boxes: Boxes2D | Boxes3D) -> Text:
    names = boxes.label if boxes.source_label is None else boxes.source_label
    return np.full(len(boxes), "") if names is None else names


_ALPHA = re.compile(r"alpha=(-?[0-9]{1,4}(?:\.[0-9]{1,9})?)")  # Attribute of 2D truth from KITTI's labels
_UNKNOWN_ALPHA = -10.0


@dataclass(frozen=True, eq=False)
class Rows:
    """N objects of several frames."""

    frame: Int64  # (N,) ascending
    found: ImageRows  # A rectangle is NaN where there is none

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, rows: Bool | Int64) -> "Rows":
        f = self.found
        return Rows(
            self.frame[rows], ImageRows(f.xyxy_px[rows], f.flat, f.flat_rows[rows], f.solid, f.solid_rows[rows])
        )

    @property
    def ignored(self) -> Bool:
        """(N,)"""
        return np.asarray(self.found.column("ignore", False), bool)


def both(flat_frame: Int64, flat: Boxes2D, chosen: Int64, solid_frame: Int64, solid: Boxes3D) -> Rows:
    """Return the objects of 2D boxes of one camera, and of 3D boxes: in each frame those with a 2D box in their order,
    then the others.

    Args:
        flat_frame: (N,) frame of each 2D box.
        flat: N of them.
        chosen: Rows of those in the camera's image.
        solid_frame: (M,)
        solid: 3D boxes.
    """
    mates = twins(flat_frame[chosen], flat[chosen], solid_frame, solid)
    alone = np.setdiff1d(np.arange(len(solid)), mates)
    frame = np.concatenate([flat_frame[chosen], solid_frame[alone]])
    xyxy = np.concatenate([flat.xyxy_px[chosen], np.full((len(alone), 4), np.nan)])
    flat_rows = np.concatenate([chosen, np.full(len(alone), -1)])
    rows = Rows(frame, ImageRows(xyxy, flat, flat_rows, solid, np.concatenate([mates, alone])))
    return rows[np.argsort(frame, kind="stable")] if (np.diff(frame) < 0).any() else rows


def concatenated(parts: Sequence[Rows]) -> Rows:
    """Join rows of the same boxes, one part after the other."""
    first = parts[0].found
    xyxy, flat_rows, solid_rows = (
        np.concatenate([getattr(part.found, name) for part in parts]) for name in ("xyxy_px", "flat_rows", "solid_rows")
    )
    frame = np.concatenate([part.frame for part in parts])
    return Rows(frame, ImageRows(xyxy, first.flat, flat_rows, first.solid, solid_rows))


def objects_of(rows: Rows, family: Family | None, step: Int64, alpha_rad: Float64 | None = None) -> Objects:
    """Return rows as objects with the benchmark's names, in their order; solids are where the 3D boxes are.

    Args:
        rows: N, sorted by step.
        family: Of the benchmark; `None`: of none.
        step: (N,) ascending.
        alpha_rad: (N,) angles of observation that follow from the boxes; those that the source tells go first.
    """
    found, ignored = rows.found, rows.ignored
    center, size, yaw = _solids(found)
    return Objects(
        step=step,
        label=names_of(family, found.column("source_label", ""), found.column("label", ""), ignored),
        track_id=_rows_ids(rows, family),
        score=_scores(found),
        xyxy_px=_known(found.xyxy_px),
        center_m=center,
        size_lwh_m=size,
        yaw_rad=yaw,
        alpha_rad=_alphas(found, alpha_rad),
        occlusion=_numbers(found, "occlusion"),
        truncation=_numbers(found, "truncation"),
        visibility=_numbers(found, "visibility"),
        ignore=ignored if ignored.any() else None,
    )


def _rows_ids(rows: Rows, family: Family | None) -> Int64:
    """MOTChallenge's regions have ids too, which no other box has."""
    ids = np.asarray(rows.found.column("track_id", -1), np.int64)
    if family != "mot":
        return ids
    nameless = np.flatnonzero(rows.ignored & (ids < 0))
    ids = ids.copy()
    ids[nameless] = int(ids.max(initial=-1)) + 1 + np.arange(len(nameless))
    return ids


def _scores(found: ImageRows) -> Float64:
    return np.zeros(len(found)) if _has_none(found, "score") else np.asarray(found.column("score", 0.0), np.float64)


def _has_none(found: ImageRows, name: str) -> bool:
    return getattr(found.flat, name) is None and getattr(found.solid, name) is None


def _alphas(found: ImageRows, derived: Float64 | None) -> Float64 | None:
    """As the source tells them, else as they follow from the boxes."""
    angles = np.full(len(found), np.nan) if derived is None else derived.copy()
    if not _has_none(found, "attribute"):
        texts = found.column("attribute", "")
        told = [(row, match) for row, text in enumerate(texts.tolist()) if (match := _ALPHA.fullmatch(text))]
        for row, match in told:
            alpha = float(match[1])
            angles[row] = np.nan if alpha == _UNKNOWN_ALPHA else alpha
    return _known(angles)


def _solids(found: ImageRows) -> tuple[Float64 | None, Float64 | None, Float64 | None]:
    """Centre (N, 3), size (N, 3) and yaw (N,); NaN where there is no solid, `None` where there is none at all."""
    has = found.solid_rows >= 0
    if not has.any():
        return None, None, None
    own, num = found.solid[found.solid_rows[has]], len(found)
    center, size, yaw = np.full((num, 3), np.nan), np.full((num, 3), np.nan), np.full(num, np.nan)
    center[has], size[has], yaw[has] = own.center_m, own.size_lwh_m, own.yaw_rad
    return center, size, yaw


def _numbers(found: ImageRows, name: str) -> Float64 | None:
    return _known(np.asarray(found.column(name, np.nan), np.float64))


def _known(values: Float64) -> Float64 | None:
    return None if np.isnan(values).all() else values
