"""Which box in an image and which box in space are one object, over many frames at once."""

import numpy as np

from fbench.replay.arrays import Array, Bool, Int64, Text
from fbench.replay.boxes import Boxes2D, Boxes3D


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
