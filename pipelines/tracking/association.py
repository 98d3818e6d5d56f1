"""Association of detections with tracks by their similarity, in an order that content alone decides."""

import numpy as np
from scipy.optimize import linear_sum_assignment

from fbench.pipelines.tracking.kalman import PLACE, PLACE_VAR, States
from fbench.pipelines.tracking.kernels import generalize_iou
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.geometry.iou import flat_iou, iou_2d


def associate(similarity: Float64, min_similarity: float) -> tuple[Int64, Int64]:
    """Pair rows with columns of `similarity` (N, M) so that the sum is largest (Hungarian method). Pairs below
    `min_similarity`, and those without any similarity, are never made. Returns rows and columns of the pairs, by row.
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

    The second turn is that of ByteTrack (Zhang et al., ECCV 2022): a hidden object's score is low, but it still shows
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


def as_similarity(giou: Float64) -> Float64:
    """Bring GIoU, -1 to 1, to 0 to 1."""
    return (giou + 1.0) / 2.0


def mahalanobis_nearness(states: States, measured: Float64, measured_std: Float64, gate: float) -> Float64:
    """Similarity (T, M) by distance in standard deviations of what is expected, 0 from `gate` of them on.

    The squared distance is (z - H x)' (H P H' + R)^-1 (z - H x) (P. C. Mahalanobis, 1936), where components don't
    influence each other. Takes predicted states, measurements (M, m) and their standard deviations (m,) or (M, m).
    """
    variance = np.broadcast_to(measured_std, measured.shape) ** 2
    apart = measured[None, :, :] - states[PLACE][:, None, :]
    squared = np.sum(apart**2 / (states[PLACE_VAR][:, None, :] + variance[None, :, :]), axis=2)
    return nearness(np.sqrt(squared), np.full(len(apart), gate))


def footprint_iou(a: Float64, b: Float64, solid: bool = False) -> Float64:
    """Overlap (N, M) of upright boxes (N, 7) and (M, 7), center, size, heading: seen from above, or in space."""
    starts = np.array([0, len(a)], np.int64), np.array([0, len(b)], np.int64)  # all boxes are of one step
    return flat_iou(a, b, *starts, solid=solid).reshape(len(a), len(b))


def giou_2d(a: Array, b: Array) -> Float64:
    """Generalized IoU (N, M) of rectangles (N, 4) and (M, 4): IoU - (hull - union) / hull (Rezatofighi et al.)."""
    low = np.minimum(a[:, None, :2], b[None, :, :2])
    high = np.maximum(a[:, None, 2:], b[None, :, 2:])
    iou, hull = iou_2d(a, b), np.prod(high - low, axis=2)
    area_a, area_b = (np.prod(np.maximum(boxes[:, 2:] - boxes[:, :2], 0.0), axis=1) for boxes in (a, b))
    union = (area_a[:, None] + area_b[None, :]) / (1.0 + iou)
    good = np.isfinite(hull) & (hull > 0)
    filled = np.divide(union, hull, out=np.zeros_like(hull), where=good)
    return np.where(good, np.clip(iou - 1.0 + filled, -1.0, 1.0), -1.0)


def giou_3d(a: Float64, b: Float64) -> Float64:
    """Generalized IoU (N, M) in space of upright boxes (N, 7) and (M, 7): center, size, heading; see `giou_2d`. The
    hull is that of both footprints, from the lower bottom to the higher top; -1 where boxes aren't finite.
    """
    return generalize_iou(np.ascontiguousarray(a), np.ascontiguousarray(b), footprint_iou(a, b, solid=True))
