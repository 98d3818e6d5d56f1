"""HOTA (Luiten et al. 2020): detection and association at 19 thresholds of similarity."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from fbench.metrics.core.exact import Counts, exact_sums, fractions
from fbench.metrics.core.problem import Problem
from fbench.metrics.tracking.identity import near_pairs

ALPHAS = np.arange(0.05, 0.99, 0.05)  # (19,) 0.05 to 0.95
ALPHAS.flags.writeable = False
_TINY = float(np.finfo(float).eps)  # How far below a threshold, and how near to 0, TrackEval 1.3.0 goes
_NONE = (0,) * len(ALPHAS)
_ZERO = (Fraction(0),) * len(ALPHAS)


@dataclass(frozen=True)
class HotaCounts(Counts):
    """Sufficient statistics of HOTA, one value for each threshold."""

    tp: tuple[int, ...] = _NONE
    fn: tuple[int, ...] = _NONE
    fp: tuple[int, ...] = _NONE
    similarity: tuple[Fraction, ...] = _ZERO  # Sum over matches
    ass_a: tuple[Fraction, ...] = _ZERO  # Sum over matches of TPA / (TPA + FNA + FPA)
    ass_re: tuple[Fraction, ...] = _ZERO  # Sum over matches of TPA / (TPA + FNA)
    ass_pr: tuple[Fraction, ...] = _ZERO  # Sum over matches of TPA / (TPA + FPA)


def hota_counts(problem: Problem) -> HotaCounts:
    """Count HOTA of a problem whose similarities are 0 (or less: none) to 1."""
    from fbench.metrics.core.assignment_kernel import best_places  # numba takes a while to import
    from fbench.metrics.core.sums_kernel import block_sums

    p, pairs, (num_truth, num_estimates) = problem, problem.pairs, problem.pairs.shape
    if not (num_truth and num_estimates):
        return HotaCounts(_NONE, (num_truth,) * len(ALPHAS), (num_estimates,) * len(ALPHAS))
    starts, place = (pairs.row_start, pairs.column_start, pairs.start), np.flatnonzero(pairs.values > 0.0)
    (truth, estimate), similarity = pairs.locate(place), pairs.values[place]
    track_pair, pair_of = near_pairs(p, place)
    # How much each pair of tracks (P,) fits: a pair of boxes adds its similarity over all of its row and column.
    of_truth, of_estimate = np.zeros(num_truth), np.zeros(num_estimates)
    block_sums(*starts, np.maximum(pairs.values, 0.0), of_truth, of_estimate)
    whole = of_estimate[estimate] + of_truth[truth] - similarity
    part = np.divide(similarity, whole, out=np.zeros(len(whole)), where=whole > _TINY)
    shared = np.bincount(pair_of, part)
    own, others = np.divmod(track_pair, p.num_estimate_ids)
    truth_size, estimate_size = np.bincount(p.truth_id)[own], np.bincount(p.estimate_id)[others]
    fit = shared / (truth_size + estimate_size - shared)
    score = np.zeros(len(pairs.values))
    score[place] = fit[pair_of] * similarity
    made = best_places(*starts, score, 0.0, 0.0)
    made = made[made >= 0]
    matched, similarity = pair_of[np.searchsorted(place, made)], pairs.values[made]  # (K,) matches
    # Those that pass k thresholds pass all below.
    num = len(ALPHAS) + 1
    passed = np.searchsorted(ALPHAS - _TINY, similarity, side="right")
    used, pair = np.unique(matched, return_inverse=True)
    by_pair = np.bincount(pair * num + passed, minlength=len(used) * num).reshape(-1, num)
    matches = np.cumsum(by_pair[:, ::-1], axis=1)[:, -2::-1]  # of each pair of tracks at each threshold
    total = np.cumsum(exact_sums(similarity, passed, num)[::-1], axis=0)[-2::-1]
    tp = tuple(int(n) for n in matches.sum(axis=0))
    pair, alpha = np.nonzero(matches)
    c = matches[pair, alpha].astype(np.float64)
    own, other = truth_size[used][pair], estimate_size[used][pair]
    association = (fractions(exact_sums(c * (c / size), alpha, len(ALPHAS))) for size in (own + other - c, own, other))
    fn, fp = tuple(num_truth - n for n in tp), tuple(num_estimates - n for n in tp)
    return HotaCounts(tp, fn, fp, fractions(total), *association)
