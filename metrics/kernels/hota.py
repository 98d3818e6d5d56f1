"""HOTA: pairs that fit over time, and how well they do at each threshold."""

import numpy as np

from fbench.metrics.kernels.assignment_steps import best_pairs
from fbench.metrics.kernels.exact import LIMBS, add_exact
from fbench.replay.arrays import Float64, Int64
from fbench.replay.kernels import kernel

TINY = 2.220446049250313e-16


@kernel
def shared_weight(
    truth_start: Int64, estimate_start: Int64, block_start: Int64, similarity: Float64, pair: Int64, num_pairs: int
) -> Float64:
    """Return how much each pair of tracks (P,) fits, summed over steps.

    A pair of boxes adds its similarity over all similarities of its row and column together.

    Args:
        truth_start: (S + 1,)
        estimate_start: (S + 1,)
        block_start: (S + 1,)
        similarity: (B,) 0 to 1.
        pair: (B,) pair of tracks of each pair of boxes, -1 where the similarity is 0.
        num_pairs: P.
    """
    weight = np.zeros(num_pairs)
    for step in range(len(truth_start) - 1):
        n, m = truth_start[step + 1] - truth_start[step], estimate_start[step + 1] - estimate_start[step]
        start = block_start[step]
        of_row, of_column = np.zeros(n), np.zeros(m)
        for i in range(n):
            for j in range(m):
                of_row[i] += similarity[start + i * m + j]
                of_column[j] += similarity[start + i * m + j]
        for i in range(n):
            for j in range(m):
                b = start + i * m + j
                whole = of_column[j] + of_row[i] - similarity[b]
                if pair[b] >= 0 and whole > TINY:
                    weight[pair[b]] += similarity[b] / whole
    return weight


@kernel
def hota_pairs(
    truth_start: Int64, estimate_start: Int64, block_start: Int64, similarity: Float64, pair: Int64, fit: Float64,
    alphas: Float64,
) -> tuple[Int64, Int64]:  # fmt: skip
    """Return how many matches each pair of tracks has by the thresholds they pass (P, A + 1), and the exact sums of
    the similarities of matches that pass k thresholds (A + 1, LIMBS).

    Args:
        truth_start: (S + 1,)
        estimate_start: (S + 1,)
        block_start: (S + 1,)
        similarity: (B,)
        pair: (B,)
        fit: (P,) of each pair of tracks: boxes are matched so that fit times similarity sums up to the most.
        alphas: (A,) ascending.
    """
    passed = np.zeros((len(fit), len(alphas) + 1), np.int64)
    sums = np.zeros((len(alphas) + 1, LIMBS), np.int64)
    for step in range(len(truth_start) - 1):
        n, m = truth_start[step + 1] - truth_start[step], estimate_start[step + 1] - estimate_start[step]
        start = block_start[step]
        if n == 0 or m == 0:
            continue
        score = np.zeros((n, m))
        for i in range(n):
            for j in range(m):
                b = start + i * m + j
                if pair[b] >= 0:
                    score[i, j] = fit[pair[b]] * similarity[b]
        column_of = best_pairs(score)
        for i in range(n):
            if column_of[i] >= 0:
                b = start + i * m + column_of[i]
                k = 0
                while k < len(alphas) and similarity[b] >= alphas[k] - TINY:
                    k += 1
                passed[pair[b], k] += 1
                add_exact(sums[k], similarity[b])
    return passed, sums


@kernel
def association(matches: Int64, truth_size: Int64, estimate_size: Int64) -> Int64:
    """Return the exact sums (3, A, LIMBS) over matches of association accuracy, recall and precision.

    Args:
        matches: (P, A) of each pair of tracks at each threshold.
        truth_size: (P,) boxes of the pair's truth track.
        estimate_size: (P,)
    """
    num_pairs, num_alphas = matches.shape
    sums = np.zeros((3, num_alphas, LIMBS), np.int64)
    for p in range(num_pairs):
        for a in range(num_alphas):
            c = float(matches[p, a])
            if c > 0.0:
                add_exact(sums[0, a], c * (c / (truth_size[p] + estimate_size[p] - c)))
                add_exact(sums[1, a], c * (c / truth_size[p]))
                add_exact(sums[2, a], c * (c / estimate_size[p]))
    return sums
