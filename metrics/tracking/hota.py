"""HOTA (Luiten et al. 2020): detection and association at 19 thresholds of similarity."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from fbench.metrics.exact import fractions, plus
from fbench.metrics.problem import Problem
from fbench.replay.arrays import Int64

ALPHAS = np.arange(0.05, 0.99, 0.05)
"""(19,) 0.05 to 0.95."""
ALPHAS.flags.writeable = False
_NONE = (0,) * len(ALPHAS)
_ZERO = (Fraction(0),) * len(ALPHAS)


@dataclass(frozen=True)
class HotaCounts:
    """Sufficient statistics of HOTA, one value for each threshold."""

    tp: tuple[int, ...] = _NONE
    fn: tuple[int, ...] = _NONE
    fp: tuple[int, ...] = _NONE
    similarity: tuple[Fraction, ...] = _ZERO
    """Sum over matches."""
    ass_a: tuple[Fraction, ...] = _ZERO
    """Sum over matches of TPA / (TPA + FNA + FPA)."""
    ass_re: tuple[Fraction, ...] = _ZERO
    """Sum over matches of TPA / (TPA + FNA)."""
    ass_pr: tuple[Fraction, ...] = _ZERO
    """Sum over matches of TPA / (TPA + FPA)."""

    def __add__(self, other: "HotaCounts") -> "HotaCounts":
        return HotaCounts(
            _plus(self.tp, other.tp),
            _plus(self.fn, other.fn),
            _plus(self.fp, other.fp),
            plus(self.similarity, other.similarity),
            plus(self.ass_a, other.ass_a),
            plus(self.ass_re, other.ass_re),
            plus(self.ass_pr, other.ass_pr),
        )


def hota_counts(problem: Problem) -> HotaCounts:
    """Count HOTA of a problem whose similarities are 0 (or less: none) to 1."""
    from fbench.metrics.kernels.hota import hota_pairs, shared_weight  # numba takes a while to import
    from fbench.metrics.kernels.identity import near_keys

    p = problem
    if not (p.num_truth and p.num_estimates):
        misses, alarms = (p.num_truth,) * len(ALPHAS), (p.num_estimates,) * len(ALPHAS)
        return HotaCounts(_NONE, misses, alarms)
    similarity = np.maximum(p.similarity, 0.0)
    keys, place = near_keys(
        p.truth_start, p.estimate_start, p.block_start, similarity, p.truth_id, p.estimate_id, np.nextafter(0.0, 1.0)
    )
    unique, inverse = np.unique(keys, return_inverse=True)
    pair = np.full(len(similarity), -1)
    pair[place] = inverse
    sizes = _sizes(p.truth_id, unique // p.num_estimate_ids), _sizes(p.estimate_id, unique % p.num_estimate_ids)
    flat = p.truth_start, p.estimate_start, p.block_start, similarity, pair
    shared = shared_weight(*flat, len(unique))
    passed, sums = hota_pairs(*flat, shared / (sizes[0] + sizes[1] - shared), np.array(ALPHAS))
    return _summed(p, passed, sums, sizes)


def _summed(problem: Problem, passed: Int64, sums: Int64, sizes: tuple[Int64, Int64]) -> HotaCounts:
    """Sum up pairs (P, A + 1) by the number of thresholds passed: those that pass k pass all below."""
    from fbench.metrics.kernels.hota import association

    matches = np.ascontiguousarray(np.cumsum(passed[:, ::-1], axis=1)[:, -2::-1])
    similarity = np.cumsum(sums[::-1], axis=0)[-2::-1]
    tp = tuple(int(n) for n in matches.sum(axis=0))
    return HotaCounts(
        tp, tuple(problem.num_truth - n for n in tp), tuple(problem.num_estimates - n for n in tp),
        fractions(similarity), *(fractions(one) for one in association(matches, *sizes)),
    )  # fmt: skip


def _sizes(ids: Int64, wanted: Int64) -> Int64:
    """Number of boxes of each wanted id."""
    return np.bincount(ids)[wanted].astype(np.int64)


def _plus(ones: tuple[int, ...], others: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(a + b for a, b in zip(ones, others, strict=True))
