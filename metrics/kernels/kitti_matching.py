"""Compiled assignment within one frame: most pairs, and of these the nearest, as Munkres with a gate gives them."""

import numpy as np

from fbench.metrics.kernels.assignment import assign
from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.kernels import kernel


@kernel
def match_frame(
    truth_first: int, truth_stop: int, estimate_first: int, estimate_stop: int, pair_start: Int64,
    pair_estimate: Int64, pair_likeness: Float64, kept: Bool, matched: Int64, likeness: Float64,
) -> None:  # fmt: skip
    """Write for the truth rows of a frame which estimate each gets (-1: none) and how alike they are.

    Pairs that no other pair touches are taken at once; only what is left is solved.
    """
    degree = np.zeros(estimate_stop - estimate_first, np.int64)
    for i in range(truth_first, truth_stop):
        matched[i], likeness[i] = -1, 0.0
        for p in range(pair_start[i], pair_start[i + 1]):
            if kept[pair_estimate[p]]:
                degree[pair_estimate[p] - estimate_first] += 1
    num_left = 0
    for i in range(truth_first, truth_stop):
        own, pair = 0, -1
        for p in range(pair_start[i], pair_start[i + 1]):
            if kept[pair_estimate[p]]:
                own, pair = own + 1, p
        if own == 1 and degree[pair_estimate[pair] - estimate_first] == 1:
            matched[i], likeness[i] = pair_estimate[pair], pair_likeness[pair]
        elif own > 0:
            matched[i] = -2
            num_left += 1
    if num_left > 0:
        _solve_rest(
            truth_first, truth_stop, estimate_first, estimate_stop, num_left, pair_start, pair_estimate,
            pair_likeness, kept, matched, likeness,
        )  # fmt: skip


@kernel
def _solve_rest(
    truth_first: int, truth_stop: int, estimate_first: int, estimate_stop: int, num_left: int, pair_start: Int64,
    pair_estimate: Int64, pair_likeness: Float64, kept: Bool, matched: Int64, likeness: Float64,
) -> None:  # fmt: skip
    """Assign truth rows marked -2. A column for each of them stands for no estimate, at a cost no pair reaches."""
    num_columns = estimate_stop - estimate_first
    cost = np.full((num_left, num_columns + num_left), np.inf)
    rows = np.zeros(num_left, np.int64)
    r = 0
    for i in range(truth_first, truth_stop):
        if matched[i] != -2:
            continue
        rows[r] = i
        cost[r, num_columns + r] = num_left + 1.0
        for p in range(pair_start[i], pair_start[i + 1]):
            if kept[pair_estimate[p]]:
                cost[r, pair_estimate[p] - estimate_first] = 1.0 - pair_likeness[p]
        r += 1
    columns = assign(cost)
    for r in range(num_left):
        i, j = rows[r], columns[r]
        matched[i] = -1
        if j < num_columns:
            matched[i] = estimate_first + j
            likeness[i] = 1.0 - cost[r, j]
