"""Boxes along the axes, in space or in an image, and what is known of them."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from fbench.replay.arrays import Array, Float64, Text


@dataclass(frozen=True, eq=False)
class Extents:
    """N boxes."""

    low: Float64
    """(N, 3) in body coordinates [m], or (N, 2) in an image [px]."""
    high: Float64
    """The opposite corners."""
    distance_m: Float64
    """(N,) from the body's origin [m]; NaN where nothing measured it."""
    range_rate_mps: Float64
    """(N,) radial velocity as measured [m/s], positive when receding; NaN where nothing measured it."""
    label: Text
    """(N,) of a camera; empty where none told."""
    score: Float64
    """(N,) 0 to 1: a camera's, and 1 for clusters, of which the thesis knows no score."""
    sources: Array
    """(N,) uint8, bits of `Source`."""

    def __len__(self) -> int:
        return len(self.low)

    def __getitem__(self, rows: Array | slice) -> "Extents":
        """Select rows by mask, index array or slice."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def extents(low: Float64, high: Float64, source: int | Array, **known: Any) -> Extents:
    """Return boxes of which nothing is known but what is given."""
    num = len(low)
    unknown: dict[str, Any] = {
        "distance_m": np.full(num, np.nan), "range_rate_mps": np.full(num, np.nan), "label": np.full(num, "", "U16"),
        "score": np.ones(num), "sources": np.broadcast_to(np.asarray(source, np.uint8), num),
    }  # fmt: skip
    return Extents(low, high, **(unknown | known))


def no_extents(num_axes: int) -> Extents:
    """Return no boxes."""
    return extents(np.zeros((0, num_axes)), np.zeros((0, num_axes)), 0)


def joined(parts: Sequence[Extents]) -> Extents:
    """Put boxes one after the other."""
    return Extents(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Extents)})


def iou(a: Extents, b: Extents) -> Float64:
    """Intersection over union (N, M): of areas in an image, of volumes in space; 0 where both are empty."""
    low = np.maximum(a.low[:, None], b.low[None])
    high = np.minimum(a.high[:, None], b.high[None])
    overlap = np.prod(np.clip(high - low, 0, None), axis=2)
    size_a, size_b = (np.prod(boxes.high - boxes.low, axis=1) for boxes in (a, b))
    union = size_a[:, None] + size_b[None] - overlap
    share: Float64 = np.divide(overlap, union, out=np.zeros_like(overlap), where=union > 0)
    return share
