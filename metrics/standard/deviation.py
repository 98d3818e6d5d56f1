"""How far what an image tells of distance and speed is from truth."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from fbench.metrics.sequence import Sequence
from fbench.metrics.statistics.exact import exact_sum
from fbench.replay.arrays import Float64


@dataclass(frozen=True)
class Deviation:
    """Sum of absolute errors of some hits; can be added exactly in any order."""

    total: Fraction = Fraction(0)
    num: int = 0

    def __add__(self, other: "Deviation") -> "Deviation":
        return Deviation(self.total + other.total, self.num + other.num)

    @classmethod
    def of(cls, truth: Float64 | None, estimates: Float64 | None) -> "Deviation":
        """Compare K hits, as far as both sides know the quantity."""
        if truth is None or estimates is None:
            return cls()
        error = np.abs(estimates - truth)
        known = error[np.isfinite(error)]
        return cls(exact_sum(known), len(known))


def range_rates(sequence: Sequence) -> Float64 | None:
    """Change of distance [m/s] (N,) of the truth boxes, positive when receding: as truth says, else from the distances
    one step before and one step after on the same track (central difference); NaN where neither is known.
    """
    truth, steps = sequence.truth, sequence.steps
    if truth.range_rate_mps is not None or truth.distance_m is None:
        return truth.range_rate_mps
    rate = np.full(len(truth), np.nan)
    stream, stamp_ns = steps.stream[truth.step], steps.stamp_ns[truth.step]
    place = steps.places[truth.step]
    order = np.lexsort([place, truth.track_id, stream])
    before, here, after = order[:-2], order[1:-1], order[2:]
    near = np.array(
        [
            (truth.track_id[here] >= 0) & (truth.track_id[other] == truth.track_id[here])
            & (stream[other] == stream[here]) & (np.abs(place[other] - place[here]) == 1)
            for other in (before, after)
        ]
    ).all(axis=0)  # fmt: skip
    lapse = (stamp_ns[after] - stamp_ns[before]) * 1e-9  # of whole numbers: floats of this size would round
    good = near & (lapse > 0)
    rate[here[good]] = (truth.distance_m[after] - truth.distance_m[before])[good] / lapse[good]
    return rate
