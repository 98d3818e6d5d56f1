"""HOTA (Luiten et al. 2020): detection and association at 19 thresholds of similarity."""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from fbench.metrics.core.exact import exact_sums, fractions, plus
from fbench.metrics.core.problem import Problem
from fbench.metrics.tracking.identity import NearPairs, near_pairs
from fbench.replay.data.arrays import Float64, Int64

ALPHAS = np.arange(0.05, 0.99, 0.05)  # (19,) 0.05 to 0.95
ALPHAS.flags.writeable = False
_TINY = float(np.finfo(float).eps)  # How far below a threshold, and how near to 0, TrackEval 1.3.0 goes
_NONE = (0,) * len(ALPHAS)
_ZERO = (Fraction(0),) * len(ALPHAS)


@dataclass(frozen=True)
class HotaCounts:
    """Sufficient statistics of HOTA, one value for each threshold."""

    tp: tuple[int, ...] = _NONE
    fn: tuple[int, ...] = _NONE
    fp: tuple[int, ...] = _NONE
    similarity: tuple[Fraction, ...] = _ZERO  # Sum over matches
    ass_a: tuple[Fraction, ...] = _ZERO  # Sum over matches of TPA / (TPA + FNA + FPA)
    ass_re: tuple[Fraction, ...] = _ZERO  # Sum over matches of TPA / (TPA + FNA)
    ass_pr: tuple[Fraction, ...] = _ZERO  # Sum over matches of TPA / (TPA + FPA)

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
    from fbench.metrics.core.assignment_kernel import best_places  # numba takes a while to import

    p = problem
    if not (p.num_truth and p.num_estimates):
        misses, alarms = (p.num_truth,) * len(ALPHAS), (p.num_estimates,) * len(ALPHAS)
        return HotaCounts(_NONE, misses, alarms)
    near = near_pairs(p, p.similarity > 0.0)
    own, others = np.divmod(near.track_pair, p.num_estimate_ids)
    sizes = _sizes(p.truth_id, own), _sizes(p.estimate_id, others)
    shared = _shared(near, p.similarity[near.place], *_sums(p))
    fit = shared / (sizes[0] + sizes[1] - shared)
    score = np.zeros(len(p.similarity))
    score[near.place] = fit[near.track_pair_of] * p.similarity[near.place]
    made = best_places(_copy(p.truth_start), _copy(p.estimate_start), _copy(p.block_start), score, 0.0, 0.0)
    made = made[made >= 0]
    return _summed(p, near.track_pair_of[np.searchsorted(near.place, made)], p.similarity[made], sizes)


def _sums(problem: Problem) -> tuple[Float64, Float64]:
    """All similarities of each truth row (N,), and of each estimate (M,)."""
    from fbench.metrics.core.sums_kernel import block_sums

    p, of_truth, of_estimate = problem, np.zeros(problem.num_truth), np.zeros(problem.num_estimates)
    starts = _copy(p.truth_start), _copy(p.estimate_start), _copy(p.block_start)
    block_sums(*starts, np.maximum(p.similarity, 0.0), of_truth, of_estimate)
    return of_truth, of_estimate


def _shared(near: NearPairs, similarity: Float64, of_truth: Float64, of_estimate: Float64) -> Float64:
    """How much each pair of tracks (P,) fits, summed over steps.

    A pair of boxes adds its similarity over all similarities of its row and column together.
    """
    whole = of_estimate[near.estimate] + of_truth[near.truth] - similarity
    part = np.divide(similarity, whole, out=np.zeros(len(whole)), where=whole > _TINY)
    shared: Float64 = np.bincount(near.track_pair_of, part).astype(np.float64)
    return shared


def _summed(problem: Problem, track_pair: Int64, similarity: Float64, sizes: tuple[Int64, Int64]) -> HotaCounts:
    """Sum up K matches; those that pass k thresholds pass all below.

    Args:
        problem: They are of it.
        track_pair: (K,) which of P pairs of tracks.
        similarity: (K,)
        sizes: (P,) boxes of each truth track, of each estimated one.
    """
    num = len(ALPHAS) + 1
    passed = np.searchsorted(ALPHAS - _TINY, similarity, side="right")
    used, pair = np.unique(track_pair, return_inverse=True)
    by_pair = np.bincount(pair * num + passed, minlength=len(used) * num).reshape(-1, num)
    matches = np.cumsum(by_pair[:, ::-1], axis=1)[:, -2::-1]
    total = np.cumsum(exact_sums(similarity, passed, num)[::-1], axis=0)[-2::-1]
    tp = tuple(int(n) for n in matches.sum(axis=0))
    return HotaCounts(
        tp, tuple(problem.num_truth - n for n in tp), tuple(problem.num_estimates - n for n in tp),
        fractions(total), *_association(matches, sizes[0][used], sizes[1][used]),
    )  # fmt: skip


def _association(matches: Int64, truth_size: Int64, estimate_size: Int64) -> Iterator[tuple[Fraction, ...]]:
    """Sums over matches of association accuracy, recall and precision at each threshold.

    Args:
        matches: (P, A) of each pair of tracks at each threshold.
        truth_size: (P,) boxes of the pair's truth track.
        estimate_size: (P,)
    """
    flat = matches.ravel()
    place = np.flatnonzero(flat)
    pair, alpha = np.divmod(place, len(ALPHAS))
    c = flat[place].astype(np.float64)
    for size in (truth_size[pair] + estimate_size[pair] - c, truth_size[pair], estimate_size[pair]):
        yield fractions(exact_sums(c * (c / size), alpha, len(ALPHAS)))


def _sizes(ids: Int64, wanted: Int64) -> Int64:
    """Number of boxes of each wanted id."""
    return np.bincount(ids)[wanted].astype(np.int64)


def _plus(ones: tuple[int, ...], others: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(a + b for a, b in zip(ones, others, strict=True))


def _copy(rows: Int64) -> Int64:
    """Kernels are compiled for writeable arrays."""
    return np.array(rows, np.int64)
