"""Compiled matching of KITTI's object benchmark: truth rows in turn take the best result that is left."""

import math

import numpy as np

from fbench.metrics.kernels.exact import LIMBS, add_exact
from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.kernels import kernel

COUNTS, IGNORED, LEFT_OUT = 0, 1, -1
"""What a result is for a class and difficulty."""


@kernel
def hit_scores(
    pair_start: Int64, pair_estimate: Int64, pair_likeness: Float64, truth_ignored: Bool, state: Int64,
    score: Float64, overlap: float,
) -> Float64:  # fmt: skip
    """Return the score (N,) of the result that each truth row takes, NaN where it isn't a hit.

    The surest result above the overlap is taken; of equally sure ones the first.
    """
    taken, scores = np.empty(len(score), np.bool_), np.empty(len(truth_ignored))
    for j in range(len(taken)):
        taken[j] = False
    for i in range(len(truth_ignored)):
        scores[i], best = np.nan, -1
        for p in range(pair_start[i], pair_start[i + 1]):
            j = pair_estimate[p]
            free = state[j] != LEFT_OUT and not taken[j]
            if free and pair_likeness[p] > overlap and (best < 0 or score[j] > score[best]):
                best = j
        if best >= 0:
            taken[best] = True
            if not truth_ignored[i] and state[best] == COUNTS:
                scores[i] = score[best]
    return scores


@kernel
def count_at(  # noqa: C901  # zeroed in loops, which compile faster than `np.zeros`
    pair_start: Int64, pair_estimate: Int64, pair_likeness: Float64, truth_ignored: Bool, state: Int64,
    score: Float64, overlap: float, covered: Bool, turned: Float64, thresholds: Float64,
) -> tuple[Int64, Int64]:  # fmt: skip
    """Return counts (K, 3) of hits, false positives and misses at each threshold, and digits (K, LIMBS) of the sum of
    their similarity of heading.

    `turned` (P,) is the similarity of heading of each pair, `covered` (M,) results that are excused where they match
    nothing.
    """
    counts, digits = np.empty((len(thresholds), 3), np.int64), np.empty((len(thresholds), LIMBS), np.int64)
    taken = np.empty(len(score), np.bool_)
    for k in range(len(thresholds)):
        for c in range(3):
            counts[k, c] = 0
        for c in range(LIMBS):
            digits[k, c] = 0
        for j in range(len(taken)):
            taken[j] = False
        for i in range(len(truth_ignored)):
            best = _nearest(
                pair_start[i], pair_start[i + 1], pair_estimate, pair_likeness, state, score, overlap, thresholds[k],
                taken,
            )  # fmt: skip
            if best >= 0:
                j = pair_estimate[best]
                taken[j] = True
                if not truth_ignored[i] and state[j] == COUNTS:
                    counts[k, 0] += 1
                    add_exact(digits[k], turned[best])
            elif not truth_ignored[i]:
                counts[k, 2] += 1
        for j in range(len(score)):
            if not taken[j] and state[j] == COUNTS and score[j] >= thresholds[k] and not covered[j]:
                counts[k, 1] += 1
    return counts, digits


@kernel
def _nearest(
    start: int, stop: int, pair_estimate: Int64, pair_likeness: Float64, state: Int64, score: Float64,
    overlap: float, threshold: float, taken: Bool,
) -> int:  # fmt: skip
    """Return the pair with the largest overlap; the first ignored result only where no other is near enough."""
    best, is_ignored = -1, False
    for p in range(start, stop):
        j = pair_estimate[p]
        if state[j] == LEFT_OUT or taken[j] or score[j] < threshold or not pair_likeness[p] > overlap:
            continue
        if state[j] == COUNTS and (best < 0 or is_ignored or pair_likeness[p] > pair_likeness[best]):
            best, is_ignored = p, False
        elif state[j] == IGNORED and best < 0:
            best, is_ignored = p, True
    return best


@kernel
def heading_similarity(pair_start: Int64, pair_estimate: Int64, truth_alpha: Float64, alpha: Float64) -> Float64:
    """Similarity (P,) of observation angles, (1 + cos) / 2."""
    similarity = np.empty(len(pair_estimate))
    for i in range(len(truth_alpha)):
        for p in range(pair_start[i], pair_start[i + 1]):
            similarity[p] = (1.0 + math.cos(truth_alpha[i] - alpha[pair_estimate[p]])) / 2.0
    return similarity
