"""Precision and recall along a ranking."""

import numpy as np

from fbench.metrics.coco.statistics import Outcome
from fbench.replay.arrays import Array


def average_precision(outcome: Array, num_truth: int, num_recalls: int) -> float:
    """Mean of the best precision at or beyond each of `num_recalls` recalls from 0 to 1, 0 where none is reached.

    Args:
        outcome: (M,) `Outcome` of estimates, the best score first.
        num_truth: Boxes to be found, at least 1.
        num_recalls: 101 in COCO.
    """
    hits, counted = np.cumsum(outcome == Outcome.HIT), np.cumsum(outcome != Outcome.IGNORED)
    precision = np.append(hits / np.maximum(counted, 1), 0.0)
    best = np.maximum.accumulate(precision[::-1])[::-1]
    reached = np.searchsorted(hits / num_truth, np.linspace(0, 1, num_recalls), side="left")
    return float(best[reached].mean())
