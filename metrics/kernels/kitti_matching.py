"""Compiled assignment within one frame: most pairs, and of these the nearest, as Munkres with a gate gives them."""

import numpy as np

from fbench.metrics.kernels.assignment import assign
from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.kernels import kernel


@kernel
def match_frame(  # noqa: C901  # apart it compiles twice as long
    truth_first: int, truth_stop: int, estimate_first: int, estimate_stop: int, pair_start: Int64,
    pair_estimate: Int64, pair_likeness: Float64, kept: Bool, matched: Int64, likeness: Float64,
) -> None:  # fmt: skip
    """Write for the truth rows of a frame which estimate each gets (-1: none) and how alike they are.

    Pairs that no other pair touches are taken at once; only what is left is solved. There, a column for each truth row
    stands for no estimate, at a cost no pair reaches.
    """
    num_columns = estimate_stop - estimate_first
    degree, rows, num_left = np.empty(num_columns, np.int64), np.empty(truth_stop - truth_first, np.int64), 0
    for j in range(num_columns):
        degree[j] = 0
    for i in range(truth_first, truth_stop):
        for p in range(pair_start[i], pair_start[i + 1]):
            if kept[pair_estimate[p]]:
                degree[pair_estimate[p] - estimate_first] += 1
    for i in range(truth_first, truth_stop):
        matched[i], likeness[i] = -1, 0.0
        own, pair = 0, -1
        for p in range(pair_start[i], pair_start[i + 1]):
            if kept[pair_estimate[p]]:
                own, pair = own + 1, p
        if own == 1 and degree[pair_estimate[pair] - estimate_first] == 1:
            matched[i], likeness[i] = pair_estimate[pair], pair_likeness[pair]
        elif own > 0:
            rows[num_left] = i
            num_left += 1
    if num_left == 0:
        return

    cost = np.empty((num_left, num_columns + num_left))
    for r in range(num_left):
        i = rows[r]
        for j in range(num_columns + num_left):
            cost[r, j] = np.inf
        cost[r, num_columns + r] = num_left + 1.0
        for p in range(pair_start[i], pair_start[i + 1]):
            if kept[pair_estimate[p]]:
                cost[r, pair_estimate[p] - estimate_first] = 1.0 - pair_likeness[p]
    columns = assign(cost, np.inf)
    for r in range(num_left):
        i, j = rows[r], columns[r]
        if j < num_columns:
            matched[i], likeness[i] = estimate_first + j, 1.0 - cost[r, j]
