"""How well predicted tracks and detections fit together, as similarities from 0, nothing in common, to 1, the same."""

import numpy as np

from fbench.pipelines.tracking.association import nearness
from fbench.pipelines.tracking.kalman import States
from fbench.replay.arrays import Array, Float64, Int64
from fbench.replay.geometry.boxes import iou_2d
from fbench.replay.geometry.rotated import flat_iou


def as_similarity(giou: Float64) -> Float64:
    """Bring GIoU, -1 to 1, to 0 to 1."""
    return (giou + 1.0) / 2.0


def mahalanobis_nearness(states: States, measured: Float64, measured_std: Float64, gate: float) -> Float64:
    """Similarity (T, M) by distance in standard deviations of what is expected, 0 from `gate` of them on.

    The squared distance is (z - H x)' (H P H' + R)^-1 (z - H x) (P. C. Mahalanobis, 1936), where components don't
    influence each other.

    Args:
        states: T tracks, predicted.
        measured: (M, m)
        measured_std: (m,), or (M, m) for each measurement.
        gate: In standard deviations.
    """
    variance = np.broadcast_to(measured_std, measured.shape) ** 2
    apart = measured[None, :, :] - states.place[:, None, :]
    squared = np.sum(apart**2 / (states.place_var[:, None, :] + variance[None, :, :]), axis=2)
    return nearness(np.sqrt(squared), np.full(len(states), gate))


def footprint_iou(a: Float64, b: Float64) -> Float64:
    """Overlap (N, M) seen from above of upright boxes (N, 7) and (M, 7): centre, size, heading."""
    return flat_iou(a, b, *_starts(a, b), solid=False).reshape(len(a), len(b))


def image_iou(a: Array, b: Array) -> Float64:
    """Overlap (N, M) of rectangles (N, 4) and (M, 4): left, top, right, bottom."""
    from fbench.pipelines.tracking.rectangle_kernel import overlaps  # numba takes a while to import

    return overlaps(np.array(a, np.float64, order="C"), np.array(b, np.float64, order="C"))


def giou_2d(a: Array, b: Array) -> Float64:
    """Generalised IoU (N, M) of rectangles (N, 4) and (M, 4): IoU - (hull - union) / hull (Rezatofighi et al.)."""
    low = np.minimum(a[:, None, :2], b[None, :, :2])
    high = np.maximum(a[:, None, 2:], b[None, :, 2:])
    iou, hull = iou_2d(a, b), np.prod(high - low, axis=2)
    union = (_areas(a)[:, None] + _areas(b)[None, :]) / (1.0 + iou)
    good = np.isfinite(hull) & (hull > 0)
    filled = np.divide(union, hull, out=np.zeros_like(hull), where=good)
    return np.where(good, np.clip(iou - 1.0 + filled, -1.0, 1.0), -1.0)


def giou_3d(a: Float64, b: Float64) -> Float64:
    """Generalised IoU (N, M) in space of upright boxes (N, 7) and (M, 7): centre, size, heading; see `giou_2d`.

    The hull is that of both footprints, from the lower bottom to the higher top; -1 where boxes aren't finite.
    """
    from fbench.pipelines.tracking.hull_kernel import generalised  # numba takes a while to import

    iou = flat_iou(a, b, *_starts(a, b), solid=True).reshape(len(a), len(b))
    return generalised(np.ascontiguousarray(a), np.ascontiguousarray(b), iou)


def _starts(a: Float64, b: Float64) -> tuple[Int64, Int64]:
    """All boxes are of one step."""
    return np.array([0, len(a)], np.int64), np.array([0, len(b)], np.int64)


def _areas(boxes: Array) -> Float64:
    return np.asarray(np.prod(np.maximum(boxes[:, 2:] - boxes[:, :2], 0.0), axis=1), np.float64)
