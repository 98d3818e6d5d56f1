"""Greedy matching over the steps of a sequence: estimates choose truth, the best score first."""

from collections.abc import Sequence

import numpy as np

from fbench.replay.arrays import Array, Bool, Float64, Int64


def match_greedily(
    similarity: Float64,
    truth_start: Int64,
    estimate_start: Int64,
    block_start: Int64,
    order: Int64,
    floors: Sequence[float],
    strict: bool = False,
    rank: Array | None = None,
    shared: Bool | None = None,
) -> Int64:
    """Give each estimate in turn the most similar truth box of its step that is free; returns truth rows (T, M) or -1.

    The rule of COCO, nuScenes and Pascal VOC. Equally similar truth boxes: the lower row, so sort rows by content.

    Args:
        similarity: (B,) as in `Problem`; NaN and -inf never match.
        truth_start: (S + 1,) offsets of steps in N truth rows.
        estimate_start: (S + 1,) in M estimates.
        block_start: (S + 1,) in `similarity`.
        order: (M,) rows of estimates in the order in which they choose, step by step: see `score_order`.
        floors: T similarities from which on boxes match; each is matched for itself.
        strict: Whether boxes at the floor itself don't match (nuScenes).
        rank: (N,) truth of a lower rank (or false) is taken first, whatever the similarity: 0 for what counts,
            1 for what is ignored, so that it gets what no other truth wants. All 0 by default.
        shared: (N,) truth that any number of estimates may match (crowds); none by default.
    """
    from fbench.metrics.kernels.greedy import greedy_blocks  # numba takes a while to import

    num = int(truth_start[-1])
    ranks = np.zeros(num, np.int64) if rank is None else np.array(rank, np.int64)
    many = np.zeros(num, bool) if shared is None else np.array(shared, bool)
    starts = _copy(truth_start), _copy(estimate_start), _copy(block_start)
    values = np.array(similarity, np.float64)
    return greedy_blocks(values, *starts, _copy(order), np.array(floors, np.float64), strict, ranks, many)


def _copy(rows: Int64) -> Int64:
    """Kernels are compiled for writeable arrays."""
    return np.array(rows, np.int64)


def score_order(step: Int64, score: Float64, content: Array) -> Int64:
    """Return rows (M,) by step, then score descending (NaN last), then content (M, K), for `match_greedily`."""
    keys = [content[:, k] for k in reversed(range(content.shape[1]))]
    return np.lexsort((*keys, -score, step)).astype(np.int64)
