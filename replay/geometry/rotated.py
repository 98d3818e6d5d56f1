"""Overlap of upright boxes with heading, seen from above and in space."""

import numpy as np

from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.boxes import MAX_MAGNITUDE, Boxes3D


def iou_bev(a: Boxes3D, b: Boxes3D) -> Float64:
    """Intersection over union (N, M) of the boxes' footprints, turned by yaw; roll and pitch are left out.

    0 where a box has no area; -inf where one isn't finite or has a negative size.
    """
    return _iou(a, b, solid=False)


def iou_3d(a: Boxes3D, b: Boxes3D) -> Float64:
    """Intersection over union (N, M) of the boxes in space, turned by yaw; roll and pitch are left out.

    0 where a box has no volume; -inf where one isn't finite or has a negative size.
    """
    return _iou(a, b, solid=True)


def flat_iou(a: Float64, b: Float64, start_a: Int64, start_b: Int64, solid: bool) -> Float64:
    """Intersection over union of the pairs of S steps, flat: step by step, row-major, one row a box of `a`.

    Args:
        a: (N, 7) upright boxes: centre x, y, z, length, width, height [m], heading [rad].
        b: (M, 7)
        start_a: (S + 1,) offsets: step s has rows `start_a[s]:start_a[s + 1]` of `a`.
        start_b: (S + 1,)
        solid: In space; else of the footprints.
    """
    from fbench.replay.geometry.overlap_kernel import iou_blocks  # numba takes a while to import

    return iou_blocks(_rows(a), _rows(b), comparable(a), comparable(b), start_a, start_b, solid)


def comparable(boxes: Float64) -> Bool:
    """Tell which upright boxes (N, 7) are finite and have no negative size."""
    finite: Bool = np.all(np.abs(np.nan_to_num(boxes, nan=np.inf)) < MAX_MAGNITUDE, axis=1)
    sound: Bool = finite & np.all(boxes[:, 3:6] >= 0, axis=1)
    return sound


def upright(boxes: Boxes3D) -> Float64:
    """Centre, size and heading (N, 7) of boxes."""
    return np.column_stack([boxes.center_m, boxes.size_lwh_m, boxes.yaw_rad])


def _iou(a: Boxes3D, b: Boxes3D, solid: bool) -> Float64:
    start_a, start_b = (np.array([0, len(boxes)], np.int64) for boxes in (a, b))
    return flat_iou(upright(a), upright(b), start_a, start_b, solid).reshape(len(a), len(b))


def _rows(boxes: Float64) -> Float64:
    return np.ascontiguousarray(boxes, np.float64)
