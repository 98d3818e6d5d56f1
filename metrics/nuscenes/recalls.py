"""From which scores on results are taken to reach each recall, and what counts there."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import fsum

import numpy as np

from fbench.metrics.nuscenes.clip import Clip
from fbench.metrics.nuscenes.settings import TrackingSettings
from fbench.replay.arrays import Array, Float64


@dataclass(frozen=True, eq=False)
class Sweep:
    """Counts of one class over all sequences at the T thresholds that are reached, highest recall first."""

    threshold: Float64
    """(T,)"""
    counts: Array
    """(T, 11), columns as in `fbench.metrics.kernels.nuscenes_tracks`."""
    total_m: Float64
    """(T,) sum of the distances of all pairs."""

    def num(self, name: str) -> Float64:
        """One of the counts (T,)."""
        from fbench.metrics.kernels.nuscenes_tracks import COUNTS  # numba takes a while to import

        num: Float64 = self.counts[:, COUNTS.index(name)].astype(np.float64)
        return num


def sweep_class(clips: Sequence[Clip], settings: TrackingSettings) -> Sweep:
    """Find the thresholds of one class and count at each."""
    from fbench.metrics.kernels.nuscenes_tracks import COUNTS, sweep  # numba takes a while to import

    threshold = _thresholds(clips, settings)
    distinct, index = np.unique(threshold, return_inverse=True)
    counts = np.zeros((len(distinct), len(COUNTS)), np.int64)
    metres = []
    for clip in clips:
        own, own_m, _ = sweep(distinct, clip.candidates, clip.num_truth_tracks)
        counts += own
        metres.append(own_m)
    total_m = np.array([fsum(column) for column in zip(*metres, strict=True)])  # exact, so their order is no matter
    return Sweep(threshold, counts[index], total_m[index])


def _thresholds(clips: Sequence[Clip], settings: TrackingSettings) -> Float64:
    """Scores (T,) at which the recalls from `min_recall` to 1 would be reached, as far as they are; highest first.

    Interpolated between the scores of matches when all results are taken (nuscenes-devkit 1.2.0,
    eval/tracking/algo.py, `compute_thresholds`), so the recall at a threshold is another one.
    """
    num_truth = sum(len(clip.truth_track) for clip in clips)
    score = np.sort(np.concatenate([clip.matched_score for clip in clips]))[::-1]
    if not len(score):
        return np.zeros(0)
    recall = np.arange(1, len(score) + 1) / num_truth
    wanted = np.linspace(settings.min_recall, 1, settings.num_thresholds).round(12)
    reached = wanted[wanted <= recall[-1]]
    threshold: Float64 = np.interp(reached, recall, score, right=0)[::-1].copy()
    return threshold
