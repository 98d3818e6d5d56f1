"""Perception horizon: how far recall of detections stays high."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fbench.metrics.core.exact import Counts
from fbench.metrics.core.slices import ScoreKey
from fbench.replay.data.arrays import Bool, Float64
from fbench.replay.data.scores import Score

HORIZONS: Mapping[str, int] = {"horizon_50": 50, "horizon_80": 80, "horizon_90": 90}
"""Metrics, and the least recalls [%] that they are about."""


@dataclass(frozen=True)
class RangeCounts(Counts):
    """Truth boxes to be found by their distance: (0 m, 1 m] is 1, and so on."""

    truth: Mapping[int, int] = field(default_factory=dict)
    hits: Mapping[int, int] = field(default_factory=dict)

    @classmethod
    def of(cls, range_m: Float64 | None, hit: Bool) -> "RangeCounts":
        """Count N truth boxes, as far as their distances in the ground plane (N,) [m] are known."""
        if range_m is None:
            return cls()
        known = np.isfinite(range_m)
        meters = np.maximum(np.ceil(range_m[known]), 1).astype(np.int64)
        return cls(_count(meters), _count(meters[hit[known]]))

    def horizon_m(self, percent: int) -> int:
        """Distance [m] up to which recall is at least so high, in whole meters; 0 where it is nowhere.

        That is recall at a distance, not of all up to there: the falling curve nearest to what was counted (isotonic
        regression, Busing 2022), so that few misses near the car don't end it. The curve is at or above a level up to
        where the sum of `hit - level` over the boxes from near to far is largest, which needs no curve; where it is
        largest twice, the farther place counts.
        """
        best, best_m, total = 0, 0, 0
        for meter, num in sorted(self.truth.items()):
            total += 100 * self.hits.get(meter, 0) - percent * num
            if total >= best:
                best, best_m = total, meter
        return best_m


def _count(meters: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> dict[int, int]:
    found, num = np.unique(meters, return_counts=True)
    return dict(zip(found.tolist(), num.tolist(), strict=True))


def horizon_rows(n: RangeCounts, num_truth: int, head: ScoreKey) -> list[Score]:
    """Return one row a recall. No horizon is farther than the farthest truth box."""
    counts = {"gt": sum(n.truth.values()), "tp": sum(n.hits.values()), "frames": head.num_frames}
    why = "truth has no distances" if num_truth else "no truth boxes"
    reason = head.reason or (None if n.truth else why)
    return [
        head.score(metric, None if reason else n.horizon_m(percent), reason, counts, "m")
        for metric, percent in HORIZONS.items()
    ]
