"""The matchers: one to one by score or by the best total, and greedy by score."""

from collections.abc import Sequence

import numpy as np

from fbench.metrics.core.similarity import Blocks
from fbench.replay.data.arrays import Array, Bool, Float64, Int64


def match_greedily(
    pairs: Blocks, order: Int64, floors: Sequence[float], strict: bool = False, rank: Array | None = None,
    shared: Bool | None = None,
) -> Int64:  # fmt: skip
    """Give each estimate in turn the most similar truth box of its step that is free; returns truth rows (T, M) or -1.

    The rule of COCO, nuScenes and Pascal VOC. Equally similar truth boxes: the lower row, so sort rows by content.

    Args:
        pairs: Similarity of N truth boxes and M estimates; NaN and -inf never match.
        order: (M,) rows of estimates in the order in which they choose, step by step: see `score_order`.
        floors: T similarities from which on boxes match; each is matched for itself.
        strict: Whether boxes at the floor itself don't match (nuScenes).
        rank: (N,) truth of a lower rank (or false) is taken first, whatever the similarity: 0 for what counts,
            1 for what is ignored, so that it gets what no other truth wants. All 0 by default.
        shared: (N,) truth that any number of estimates may match (crowds); none by default.
    """
    from fbench.metrics.core.assignment_kernel import greedy_blocks  # numba takes a while to import

    num = pairs.shape[0]
    return greedy_blocks(
        pairs.values, pairs.row_start, pairs.column_start, pairs.start, np.array(order, np.int64),
        np.array(floors, np.float64), strict, np.zeros(num, np.int64) if rank is None else np.array(rank, np.int64),
        np.zeros(num, bool) if shared is None else np.array(shared, bool),  # copied: kernels want writeable arrays
    )  # fmt: skip


def score_order(step: Int64, score: Float64, content: Array) -> Int64:
    """Return rows (M,) by step, then score descending (NaN last), then content (M, K), for `match_greedily`."""
    return np.lexsort((*content.T[::-1], -score, step)).astype(np.int64)


def match_greedy(similarity: Blocks, floor: float, score: Float64, late: Bool | None = None) -> Int64:
    """Give each estimate, best score first, the most similar truth box of its step that is still free.

    The rule of the nuScenes and KITTI detection benchmarks. Equal scores: the more similar pair first, then the
    lower index of the estimate, then of the truth box.

    Args:
        similarity: Of N truth boxes and M estimates, higher is nearer (distances are negated); NaN, -inf never match.
        floor: Pairs match from this similarity on.
        score: (M,) of the estimates.
        late: (M,) estimates that choose after all others; none by default.

    Returns (M,) the truth box of each estimate, -1 where it has none.
    """
    from fbench.metrics.core.assignment_kernel import first_come  # numba takes a while to import

    valid = np.flatnonzero(similarity.values >= floor)
    (truth, estimates), value = similarity.locate(valid), similarity.values[valid]
    is_late = np.zeros(len(score), bool) if late is None else late
    # Boxes of different steps never meet, so one order serves all.
    order = np.lexsort((truth, estimates, -value, -score[estimates], is_late[estimates]))
    return first_come(truth[order], estimates[order], *similarity.shape)


def match_best(similarity: Blocks, floor: float, late: Bool | None = None) -> Int64:
    """Pair as many as possible in each step; among these, use fewest late estimates; among these, the highest total.

    Pairs below the floor are not only dropped, they can't displace a valid pair either. As `match_greedy`, but `late`
    (M,) are estimates to use only where no other will do; returns (M,) the truth box of each estimate, -1 where it has
    none.
    """
    from fbench.metrics.core.assignment_kernel import best_rows  # numba takes a while to import

    favored = np.ones(similarity.shape[1], bool) if late is None else ~late
    starts = similarity.row_start, similarity.column_start, similarity.start
    return best_rows(*starts, similarity.values, floor, favored)
