"""Precision and errors over recall, and their means; nuscenes-devkit 1.2.0, eval/detection/algo.py."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.nuscenes.ranking import ClassRanking
from fbench.replay.arrays import Array, Bool, Float64

NUM_RECALLS = 101
"""Precision is read at recalls 0, 0.01 ... 1."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Precision and score (101,) at each recall; both 0 beyond the recall that is achieved."""

    precision: Float64
    confidence: Float64

    @property
    def last(self) -> int:
        """Index of the highest recall achieved: the last score that isn't 0."""
        used = np.flatnonzero(self.confidence)
        return int(used[-1]) if len(used) else 0


def precision_curve(score: Float64, hit: Bool, num_truth: int) -> Curve:
    """Return the curve of results (M,), best score first, at one distance: linear between the recalls of results."""
    if not num_truth or not hit.any():
        return Curve(np.zeros(NUM_RECALLS), np.zeros(NUM_RECALLS))
    tp = np.cumsum(hit)
    recall, precision = tp / num_truth, tp / np.arange(1, len(tp) + 1)
    wanted = np.linspace(0, 1, NUM_RECALLS)
    return Curve(np.interp(wanted, recall, precision, right=0), np.interp(wanted, recall, score, right=0))


def average_precision(precision: Float64, min_recall: float, min_precision: float) -> float:
    """Mean of precision (101,) above `min_recall`, less `min_precision` and floored at 0, as share of its maximum."""
    kept = np.maximum(precision[_first(min_recall) :] - min_precision, 0.0)
    return float(np.mean(kept)) / (1.0 - min_precision)


def mean_errors(ranking: ClassRanking, hit: Bool, curve: Curve, min_recall: float) -> Float64:
    """Return each error (5,), cumulated over hits by score, averaged over recalls up to the highest achieved.

    Recalls up to `min_recall` are left out; where no higher one is achieved, every error is 1. An error that no hit
    has (NaN) is 1 too.
    """
    first, last = _first(min_recall), curve.last
    num = ranking.error.shape[1]
    if last < first or not hit.any():
        return np.ones(num)
    score, errors = ranking.score[hit][::-1], ranking.error[hit]
    wanted = curve.confidence[first : last + 1][::-1]
    means = [np.mean(np.interp(wanted, score, cumulative_mean(errors[:, i])[::-1])[::-1]) for i in range(num)]
    return np.array(means, np.float64)


def cumulative_mean(values: Array) -> Float64:
    """Mean of the values (K,) up to each, without NaN: 0 before the first number, 1 throughout where there is none."""
    known = ~np.isnan(values)
    if not known.any():
        return np.ones(len(values))
    num = np.cumsum(known)
    mean: Float64 = np.cumsum(np.where(known, values, 0.0)) / np.maximum(num, 1)
    return mean


def _first(min_recall: float) -> int:
    return round((NUM_RECALLS - 1) * min_recall) + 1
