"""Identity (Ristani et al. 2016): one estimated track for each truth track, over all steps."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.problem import Problem
from fbench.replay.arrays import Int64


@dataclass(frozen=True)
class IdentityCounts:
    """Sufficient statistics of IDF1, IDP and IDR: boxes under the right identity, and the others."""

    tp: int = 0
    fn: int = 0
    fp: int = 0

    def __add__(self, other: "IdentityCounts") -> "IdentityCounts":
        return IdentityCounts(self.tp + other.tp, self.fn + other.fn, self.fp + other.fp)


def identity_counts(problem: Problem, floor: float) -> IdentityCounts:
    """Pair tracks one to one such that false positives and misses together are the fewest.

    Args:
        problem: Boxes of one class.
        floor: Similarity that two boxes need to count as the same.
    """
    from fbench.metrics.kernels.identity import near_keys  # numba takes a while to import

    p = problem
    if not (p.num_truth and p.num_estimates):
        return IdentityCounts(0, p.num_truth, p.num_estimates)
    keys, _ = near_keys(p.truth_start, p.estimate_start, p.block_start, p.similarity, p.truth_id, p.estimate_id, floor)
    pair, weight = np.unique(keys, return_counts=True)
    tp = _best(pair // p.num_estimate_ids, pair % p.num_estimate_ids, weight) if len(pair) else 0
    return IdentityCounts(tp, p.num_truth - tp, p.num_estimates - tp)


def _best(row: Int64, column: Int64, weight: Int64) -> int:
    """Each common box of a pair saves a false positive and a miss, so that the heaviest pairing is the best."""
    from fbench.metrics.kernels.identity import best_total, linked  # numba takes a while to import

    group = linked(row, column)
    order = np.argsort(group, kind="stable")
    return int(best_total(row[order], column[order], weight[order].astype(np.int64), group[order]))
