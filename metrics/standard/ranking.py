"""Hits and false alarms by score: what every threshold would have given."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Array, Bool, Float64, Int64

_RECALLS = np.linspace(0, 1, 101)


@dataclass(frozen=True, eq=False)
class Ranking:
    """Counts at each score that occurs, highest first; can be added in any order."""

    scores: Float64
    """(U,) all different."""
    tp: Int64
    """(U,) hits of this score."""
    fp: Int64
    """(U,) false alarms of this score."""
    num_truth: int

    @classmethod
    def of(cls, scores: Float64, hit: Bool, num_truth: int) -> "Ranking":
        """Count K estimates that are a hit or a false alarm."""
        return cls(*_merged(scores, hit.astype(np.int64), (~hit).astype(np.int64)), num_truth)

    def __add__(self, other: "Ranking") -> "Ranking":
        both = (np.concatenate(pair) for pair in zip(self._columns, other._columns, strict=True))
        return Ranking(*_merged(*both), self.num_truth + other.num_truth)

    @property
    def _columns(self) -> tuple[Array, Array, Array]:
        return self.scores, self.tp, self.fp

    @property
    def reason(self) -> str | None:
        """Why there is no curve."""
        if not self.num_truth:
            return "no truth boxes"
        if not len(self.scores):
            return "no estimates"
        return "results have no scores" if len(self.scores) == 1 and self.scores[0] == 0 else None

    def best_f1(self) -> tuple[float, float]:
        """Highest F1 of all thresholds, and the highest threshold that gives it."""
        tp, fp = np.cumsum(self.tp), np.cumsum(self.fp)
        f1 = 2 * tp / (tp + fp + self.num_truth)
        best = int(np.argmax(f1))
        return float(f1[best]), float(self.scores[best])

    def average_precision(self) -> float:
        """Mean over recall 0, 0.01, ... 1 of the highest precision at that recall or above, as COCO has it; estimates
        of equal score are taken together.
        """
        tp, fp = np.cumsum(self.tp), np.cumsum(self.fp)
        precision = np.maximum.accumulate((tp / (tp + fp))[::-1])[::-1]
        at = np.searchsorted(tp / self.num_truth, _RECALLS, side="left")
        return float(np.append(precision, 0.0)[at].mean())


def _merged(scores: Float64, tp: Int64, fp: Int64) -> tuple[Float64, Int64, Int64]:
    unique, at = np.unique(-scores, return_inverse=True)
    sums = [np.zeros(len(unique), np.int64) for _ in range(2)]
    for total, part in zip(sums, (tp, fp), strict=True):
        np.add.at(total, at, part)
    return -unique, sums[0], sums[1]
