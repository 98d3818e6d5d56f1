"""The best pairs of every step of a sequence, each step on its own."""

import numpy as np

from fbench.metrics.kernels.assignment import assign
from fbench.replay.arrays import Float64, Int64
from fbench.replay.kernels import kernel


@kernel
def best_places(
    row_start: Int64, column_start: Int64, block_start: Int64, score: Float64, floor: float, offset: float
) -> Int64:
    """Return the place in `score` of the pair of each row (N,), such that scores plus `offset` sum up to the most.

    That is in each step for itself. -1 for rows without a pair; one that would add 0 or less isn't made.

    Args:
        row_start: (S + 1,)
        column_start: (S + 1,)
        block_start: (S + 1,)
        score: (B,)
        floor: Score that a pair needs.
        offset: How much any pair is worth.
    """
    place = np.empty(row_start[-1], np.int64)
    for step in range(len(row_start) - 1):
        first, b = row_start[step], block_start[step]
        n, m = row_start[step + 1] - first, column_start[step + 1] - column_start[step]
        cost = np.empty((n, m))
        for i in range(n):
            for j in range(m):
                value = score[b + i * m + j]
                gain = value + offset
                cost[i, j] = -gain if value >= floor and gain > 0.0 else np.inf
        column_of = assign(cost, 0.0)
        for i in range(n):
            place[first + i] = b + i * m + column_of[i] if column_of[i] >= 0 else -1
    return place


def partners(
    truth_start: Int64, estimate_start: Int64, block_start: Int64, similarity: Float64, floor: float, offset: float
) -> Int64:
    """Return for each estimate (M,) the truth row with which it makes the best pair of its step, -1 without one.

    Pairs need a similarity of `floor`; they are chosen so that similarity plus `offset` sums up to the most.
    """
    starts = [np.array(start, np.int64) for start in (truth_start, estimate_start, block_start)]  # writeable
    place = best_places(starts[0], starts[1], starts[2], similarity, floor, offset)
    truth = np.flatnonzero(place >= 0)
    step = np.searchsorted(truth_start, truth, side="right") - 1
    width = estimate_start[step + 1] - estimate_start[step]
    within = place[truth] - block_start[step]
    truth_of = np.full(estimate_start[-1], -1, np.int64)
    truth_of[estimate_start[step] + within % width] = truth
    return truth_of
