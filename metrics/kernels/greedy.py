"""Compiled greedy matching over all steps, for several thresholds."""

import numpy as np

from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.kernels import kernel


@kernel
def greedy_blocks(
    similarity: Float64, truth_start: Int64, estimate_start: Int64, block_start: Int64, order: Int64, floors: Float64,
    strict: bool, rank: Int64, shared: Bool,
) -> Int64:  # fmt: skip
    """Let estimates choose truth one after the other; returns truth rows (T, M), -1 where there is none.

    See `fbench.metrics.matching.greedy.match_greedily`.
    """
    partner, taken = np.empty((len(floors), len(order)), np.int64), np.empty(len(rank), np.bool_)
    for f in range(len(floors)):
        for e in range(len(order)):
            partner[f, e] = -1
        for t in range(len(taken)):
            taken[t] = False
        for s in range(len(block_start) - 1):
            first, last = truth_start[s], truth_start[s + 1]
            width = estimate_start[s + 1] - estimate_start[s]
            for place in range(estimate_start[s], estimate_start[s + 1]):
                e = order[place]
                best, best_similarity = -1, 0.0
                for t in range(first, last):
                    value = similarity[block_start[s] + (t - first) * width + e - estimate_start[s]]
                    free = shared[t] or not taken[t]
                    near = value > floors[f] if strict else value >= floors[f]
                    if free and near:
                        better = best < 0 or rank[t] < rank[best]
                        if better or (rank[t] == rank[best] and value > best_similarity):
                            best, best_similarity = t, value
                if best >= 0:
                    taken[best] = True
                    partner[f, e] = best
    return partner
