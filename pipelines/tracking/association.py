"""Which detection belongs to which track."""

import numpy as np
from scipy.optimize import linear_sum_assignment

from fbench.replay.arrays import Bool, Float64, Int64


def associate(similarity: Float64, min_similarity: float) -> tuple[Int64, Int64]:
    """Pair rows with columns of `similarity` (N, M) so that the sum is largest (Hungarian method).

    Pairs below `min_similarity`, and those without any similarity, are never made. Returns rows and columns of the
    pairs, by row.
    """
    allowed = similarity >= min_similarity if min_similarity > 0 else similarity > 0
    if np.count_nonzero(allowed) <= min(allowed.shape):
        rows, columns = np.nonzero(allowed)
        if len(set(rows.tolist())) == len(set(columns.tolist())) == len(rows):
            return rows, columns  # nothing to choose
    # Forbidden pairs are worth nothing, so they never push out an allowed pair.
    rows, columns = linear_sum_assignment(np.where(allowed, similarity, 0.0), maximize=True)
    made = allowed[rows, columns]
    return np.asarray(rows[made], np.int64), np.asarray(columns[made], np.int64)


def associate_weak_last(similarity: Float64, min_similarity: float, weak: Bool) -> tuple[Int64, Int64]:
    """Pair as `associate` does, first with strong columns alone, then what rows are left with the `weak` ones (M,).

    The second turn is that of ByteTrack (Zhang et al., ECCV 2022): a hidden object's score is low, but it still tells
    where a track goes on.
    """
    if not weak.any():
        return associate(similarity, min_similarity)
    rows, columns = associate(np.where(weak, 0.0, similarity), min_similarity)
    left = similarity.copy()
    left[:, ~weak] = 0.0
    left[rows] = 0.0
    late_rows, late_columns = associate(left, min_similarity)
    both_rows, both_columns = np.concatenate([rows, late_rows]), np.concatenate([columns, late_columns])
    order = np.argsort(both_rows, kind="stable")
    return both_rows[order], both_columns[order]


def nearness(distance_m: Float64, gate_m: Float64) -> Float64:
    """Turn distances (N, M) [m] into similarities: 1 at distance 0, falling to 0 at the gate (N,) and beyond."""
    return np.clip(1.0 - distance_m / gate_m[:, None], 0.0, 1.0)
