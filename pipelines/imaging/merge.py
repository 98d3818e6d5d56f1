"""Which boxes of several kinds of sensors show one object: all pairs are compared, and the best come first."""

import numpy as np

from fbench.pipelines.imaging.sightings import Sightings
from fbench.replay.arrays import Float64, Int64
from fbench.replay.data import Source
from fbench.replay.geometry.boxes import iou_2d

_CONTAINED = 0.7
"""What lies inside another box counts as alike by this share of itself: of what is hidden only a part is measured."""
_MISTAKEN = 0.35
"""Depths that a camera guesses agree at least so far with others: the class that tells the size may be wrong."""


def merged(seen: Sightings, min_similarity: float) -> list[Int64]:
    """Group boxes (N) that show one object; each group has at most one box of each kind of sensor.

    The best pair is joined first, whichever sensors it is of: the most similar one of the surest boxes. A camera's weak
    boxes take what all others leave. Returns rows of each group, in ascending order.
    """
    alike = similarity(seen)
    sure = np.sqrt(seen.score[:, None] * seen.score[None, :])
    first, second = np.nonzero(np.triu(alike >= min_similarity, 1) & (seen.source[:, None] != seen.source[None, :]))
    group = np.arange(len(seen))
    kinds = seen.source.astype(np.int64)
    weak = (seen.weak[:, None] | seen.weak[None, :])[first, second]
    for at in np.lexsort((-(alike * sure)[first, second], weak)):
        a, b = group[first[at]], group[second[at]]
        if a != b and not kinds[a] & kinds[b]:
            low, high = min(a, b), max(a, b)
            kinds[low] |= kinds[high]
            group[group == high] = low
    return [np.flatnonzero(group == number) for number in np.unique(group)]


def similarity(seen: Sightings) -> Float64:
    """How alike boxes are (N, N), 0 to 1: their overlap in the image times how well their depths agree."""
    flat = seen.xyxy_px.copy()
    flat[:, 1], flat[:, 3] = 0.0, 1.0  # compares left and right only
    upright = seen.upright[:, None] & seen.upright[None, :]
    guessed = seen.source == int(Source.C)
    depths = np.maximum(agreement(seen), np.where(guessed[:, None] | guessed[None, :], _MISTAKEN, 0.0))
    return np.where(upright, _overlap(seen.xyxy_px), _overlap(flat)) * depths


def _overlap(xyxy_px: Float64) -> Float64:
    overlap = np.maximum(iou_2d(xyxy_px, xyxy_px), _CONTAINED * inside(xyxy_px, xyxy_px))
    return np.asarray(np.maximum(overlap, overlap.T), np.float64)


def agreement(seen: Sightings) -> Float64:
    """How well depths agree (N, N): 1 where they are equal or one isn't known, falling with their relative errors."""
    log = np.log(np.maximum(seen.depth_m, 0.1))
    difference = np.nan_to_num(log[:, None] - log[None, :])
    variance = seen.depth_std[:, None] ** 2 + seen.depth_std[None, :] ** 2
    return np.asarray(np.exp(-0.5 * difference**2 / variance), np.float64)


def inside(a: Float64, b: Float64) -> Float64:
    """Share of each box of `a` (N, 4) that lies in each of `b` (M, 4): (N, M)."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    common = np.prod(np.clip(high - low, 0.0, None), axis=2)
    area = np.prod(a[:, 2:] - a[:, :2], axis=1)
    return np.asarray(common / np.maximum(area, 1e-9)[:, None], np.float64)
