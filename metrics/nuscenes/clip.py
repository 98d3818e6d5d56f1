"""Sufficient statistics of tracking: what CLEAR needs to count at any score."""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from fbench.metrics.nuscenes.counted import LeftOut
from fbench.metrics.nuscenes.tracks import TrackPoints
from fbench.replay.arrays import Array, Float64, freeze_fields

if TYPE_CHECKING:
    from fbench.metrics.kernels.nuscenes_tracks import Candidates


@dataclass(frozen=True, eq=False)
class Clip:
    """One class of one sequence: S steps, N truth boxes, M results, P pairs of them that are near each other.

    Tracks of different streams are different tracks. int32 and float64 only, so that many can be held.
    """

    sequence: str
    kind: int
    """Index of the class."""
    num_truth_tracks: int
    truth_start: Array
    """(S + 1,) offsets of steps."""
    truth_track: Array
    """(N,)"""
    estimate_start: Array
    """(S + 1,)"""
    estimate_track: Array
    """(M,)"""
    score: Float64
    """(M,) mean of the track; infinite for a result that isn't valid and has no finite score."""
    pair_start: Array
    """(N + 1,) offsets of the pairs of each truth box."""
    pair_estimate: Array
    """(P,) rows."""
    pair_m: Float64
    """(P,) distances."""
    matched_score: Float64 = field(default_factory=lambda: np.zeros(0))
    """(K,) of the results that match, without a switch, when all are taken."""

    def __post_init__(self) -> None:
        freeze_fields(
            self, truth_start=("i4", ("S1",)), truth_track=("i4", ("N",)), estimate_start=("i4", ("S1",)),
            estimate_track=("i4", ("M",)), score=("f8", ("M",)), pair_start=("i4", ("N1",)),
            pair_estimate=("i4", ("P",)), pair_m=("f8", ("P",)), matched_score=("f8", ("K",)),
        )  # fmt: skip

    @property
    def candidates(self) -> "Candidates":
        """What the kernels read."""
        from fbench.metrics.kernels.nuscenes_tracks import Candidates  # numba takes a while to import

        return Candidates(
            self.truth_start, self.truth_track, self.estimate_start, self.estimate_track, self.score, self.pair_start,
            self.pair_estimate, self.pair_m,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class TrackingStatistics:
    """Clips of any number of sequences; their order doesn't matter."""

    clips: tuple[Clip, ...]
    left_out: LeftOut

    def __add__(self, other: "TrackingStatistics") -> "TrackingStatistics":
        return TrackingStatistics(self.clips + other.clips, self.left_out + other.left_out)


def clips_of(
    sequence: str, truth: TrackPoints, estimates: TrackPoints, num_steps: int, num_classes: int, limit_m: float
) -> tuple[Clip, ...]:
    """Return a clip for each class of which there is any box."""
    kinds = [kind for kind in range(num_classes) if (truth.kind == kind).any() or (estimates.kind == kind).any()]
    return tuple(
        _clip(sequence, kind, truth[truth.kind == kind], estimates[estimates.kind == kind], num_steps, limit_m)
        for kind in kinds
    )


def _clip(sequence: str, kind: int, truth: TrackPoints, estimates: TrackPoints, num_steps: int, limit_m: float) -> Clip:
    from fbench.metrics.kernels.nuscenes_tracks import near_pairs, sweep  # numba takes a while to import

    truth_start, estimate_start = _starts(truth, num_steps), _starts(estimates, num_steps)
    pairs = near_pairs(truth.xy, truth_start, estimates.xy, estimate_start, estimates.invalid, limit_m)
    tracks, truth_track = np.unique(truth.track, return_inverse=True)
    clip = Clip(
        sequence, kind, len(tracks), truth_start, truth_track.astype(np.int32), estimate_start,
        estimates.track.astype(np.int32), estimates.score, *pairs,
    )  # fmt: skip
    _, _, continued = sweep(np.array([-np.inf]), clip.candidates, len(tracks))
    return replace(clip, matched_score=estimates.score[continued])


def _starts(points: TrackPoints, num_steps: int) -> Array:
    return np.searchsorted(points.step, np.arange(num_steps + 1)).astype(np.int32)
