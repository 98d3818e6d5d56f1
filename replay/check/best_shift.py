"""Which offset of a sensor's stamps makes what it sees fall onto the truth boxes, and whether that is sure."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Float64, Int64
from fbench.replay.check.fall_in import OFFSETS_NS, REACH_NS, Fit

STEP_NS = int(OFFSETS_NS[1] - OFFSETS_NS[0])
_BLOCK_NS = 500_000_000
_MIN_BLOCKS, _NUM_DRAWS = 6, 400
_MIN_SHIFT_NS, _MAX_SPREAD_NS, _EDGE_NS = 60_000_000, 80_000_000, 20_000_000
_MIN_MOVED_M = 0.6
"""Boxes that are larger than what they hold look like an offset that moves them by less."""
_MIN_GAIN = 0.08
"""So much more of what stands in and around boxes must be inside."""
_NEAR_NS = 100_000_000
"""Without any one of the tracks the offset is the same up to this."""


@dataclass(frozen=True)
class Shift:
    """An offset that makes a sensor's points fall onto the boxes, and how sure it is."""

    offset_ns: int
    spread_ns: int
    """Standard deviation."""
    share: float
    """Of the places in and around boxes, that in boxes with the offset."""
    share_before: float
    num_sweeps: int
    num_tracks: int


def shift(all_fits: Sequence[Fit]) -> Shift | None:
    """Find the offset that all agree on; `None` where they tell none, or none that matters.

    Fits of one track within half a second count as one observation. These are drawn anew (bootstrap: Efron, Annals of
    Statistics 7, 1979) to see how sure the best offset is, and each track is left out once: one with boxes of a wrong
    size must not decide alone.
    """
    blocks: dict[tuple[int, int], list[Fit]] = defaultdict(list)
    for fit in all_fits:
        blocks[fit.track_id, fit.stamp_ns // _BLOCK_NS].append(fit)
    keys = sorted(blocks)
    ids = np.array([track_id for track_id, _ in keys], np.int64)
    if len(keys) < _MIN_BLOCKS or len(np.unique(ids)) < 2:
        return None
    curves = np.array([np.mean([fit.score for fit in blocks[key]], axis=0) for key in keys])
    apart = np.array([curves[ids != one].sum(axis=0) for one in np.unique(ids)])
    found = _told_by(_peaks_ns(np.einsum("db,bk->dk", _drawn(len(keys)), curves)), _peaks_ns(apart))
    return None if found is None else _worth_it(*found, all_fits)


def _peaks_ns(curves: Float64) -> Int64:
    return np.asarray(OFFSETS_NS[np.argmax(curves, axis=1)], np.int64)


def _told_by(drawn_ns: Int64, apart_ns: Int64) -> tuple[int, int] | None:
    """Offset and standard deviation [ns], of the best offsets of all draws and of those without one of the tracks;
    `None` where they don't agree on one that is neither 0 nor at the end of what was tried.
    """
    offset_ns = round(float(np.mean(drawn_ns)) / STEP_NS) * STEP_NS
    spread_ns = round(float(np.std(drawn_ns)))
    low, high = np.quantile(drawn_ns, (0.02, 0.98))
    is_sure = low * high > 0 and 3 * spread_ns <= abs(offset_ns) and spread_ns <= _MAX_SPREAD_NS
    is_inside = _MIN_SHIFT_NS <= abs(offset_ns) <= REACH_NS - _EDGE_NS
    agrees = bool(np.abs(apart_ns - offset_ns).max() <= _NEAR_NS)
    return (offset_ns, spread_ns) if is_sure and is_inside and agrees else None


def _worth_it(offset_ns: int, spread_ns: int, all_fits: Sequence[Fit]) -> Shift | None:
    """`None` where boxes of a slightly wrong size would explain the offset as well."""
    at, zero = int(np.searchsorted(OFFSETS_NS, offset_ns)), len(OFFSETS_NS) // 2
    moved_m = float(np.median([fit.moved_m[at] for fit in all_fits]))
    share, before = _share(all_fits, at), _share(all_fits, zero)
    if moved_m < _MIN_MOVED_M or share < before + _MIN_GAIN:
        return None
    num_sweeps, num_tracks = len({fit.stamp_ns for fit in all_fits}), len({fit.track_id for fit in all_fits})
    return Shift(offset_ns, spread_ns, share, before, num_sweeps, num_tracks)


def _drawn(num: int) -> Float64:
    """How often each of `num` blocks is in each draw, (D, num)."""
    generator = np.random.Generator(np.random.Philox(key=num))
    draws = generator.integers(num, size=(_NUM_DRAWS, num))
    return np.array([np.bincount(draw, minlength=num) for draw in draws], np.float64)


def _share(all_fits: Sequence[Fit], at: int) -> float:
    around = sum(int(fit.num_around[at]) for fit in all_fits)
    return sum(int(fit.num_inside[at]) for fit in all_fits) / max(around, 1)
