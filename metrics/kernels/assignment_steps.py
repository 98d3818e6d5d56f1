"""The best pairs of every step of a sequence, each step on its own."""

import numpy as np

from fbench.metrics.kernels.assignment import assign
from fbench.replay.arrays import Float64, Int64
from fbench.replay.kernels import kernel


@kernel
def lonely(score: Float64, column_of: Int64) -> bool:
    """Fill in the column (n,) of each row where no row and no column of scores (n, m) has two above 0.

    Then those above 0 are the pairs whose scores sum up to the most. `False` where it isn't so; `column_of` is then
    unusable.
    """
    n, m = score.shape
    taken = np.zeros(m, np.bool_)
    for i in range(n):
        column_of[i] = -1
        for j in range(m):
            if score[i, j] > 0.0:
                if column_of[i] >= 0 or taken[j]:
                    return False
                column_of[i], taken[j] = j, True
    return True


@kernel
def best_pairs(score: Float64) -> Int64:
    """Return the column (n,) of each row, such that scores (n, m) >= 0 sum up to the most; -1 where it would add 0."""
    n = score.shape[0]
    column_of = np.empty(n, np.int64)
    if lonely(score, column_of):
        return column_of
    column_of[:] = assign(-score)
    for i in range(n):
        if column_of[i] >= 0 and score[i, column_of[i]] <= 0.0:
            column_of[i] = -1
    return column_of


@kernel
def partners(
    truth_start: Int64, estimate_start: Int64, block_start: Int64, similarity: Float64, floor: float, offset: float
) -> Int64:
    """Return for each estimate (M,) the truth row with which it makes the best pair of its step, -1 without one.

    Pairs need a similarity of `floor`; they are chosen so that similarity plus `offset` sums up to the most.
    """
    truth_of = np.full(estimate_start[-1], -1, np.int64)
    for step in range(len(truth_start) - 1):
        first, n = truth_start[step], truth_start[step + 1] - truth_start[step]
        other, m = estimate_start[step], estimate_start[step + 1] - estimate_start[step]
        if n == 0 or m == 0:
            continue
        score = np.zeros((n, m))
        for i in range(n):
            for j in range(m):
                value = similarity[block_start[step] + i * m + j]
                if value >= floor:
                    score[i, j] = value + offset
        column_of = best_pairs(score)
        for i in range(n):
            if column_of[i] >= 0:
                truth_of[other + column_of[i]] = first + i
    return truth_of
