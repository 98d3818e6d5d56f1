"""Corners and overlap (intersection over union) of boxes, in images, seen from above and in space."""

from collections.abc import Sized
from dataclasses import replace

import numpy as np

from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.boxes import MAX_MAGNITUDE, Boxes3D
from fbench.replay.geometry.transforms import transform

_SIGNS = np.array([[1 - 2 * (i & 1), 1 - 2 * (i >> 1 & 1), 1 - 2 * (i >> 2 & 1)] for i in range(8)]) / 2.0


def corners(boxes: Boxes3D) -> Float64:
    """Corners (N, 8, 3) [m] in body coordinates; corner i differs from j along one edge where i ^ j is 1, 2 or 4. R =
    Rz(yaw) Ry(pitch) Rx(roll), x along length, y along width, z along height.
    """
    local = boxes.size_lwh_m[:, None, :] * _SIGNS[None]
    x, y, z = local[..., 0], local[..., 1], local[..., 2]
    for angle, axis in ((boxes.roll_rad, 0), (boxes.pitch_rad, 1), (boxes.yaw_rad, 2)):
        if angle is None:
            continue
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        if axis == 0:
            y, z = cos * y - sin * z, sin * y + cos * z
        elif axis == 1:
            x, z = cos * x + sin * z, cos * z - sin * x
        else:
            x, y = cos * x - sin * y, sin * x + cos * y
    return boxes.center_m[:, None, :] + np.stack([x, y, z], axis=2)


def iou_2d(a: Array, b: Array) -> Float64:
    """Intersection over union (N, M) of rectangles (N, 4) and (M, 4), left, top, right, bottom; 0 if both are empty."""
    from fbench.replay.geometry.overlap_kernels import rectangle_blocks  # numba takes a while to import

    a, b = (np.array(rectangles, np.float64, order="C") for rectangles in (a, b))
    sound_a, sound_b, region = np.ones(len(a), bool), np.ones(len(b), bool), np.zeros(len(a), bool)
    return rectangle_blocks(a, b, sound_a, sound_b, *_one_step(a, b), region).reshape(len(a), len(b))


def _one_step(a: Sized, b: Sized) -> tuple[Int64, Int64]:
    return np.array([0, len(a)], np.int64), np.array([0, len(b)], np.int64)


def common_areas(a: Float64, b: Float64) -> Float64:
    """Area (N, M) that rectangles (N, 4) and (M, 4) share: left, top, right, bottom."""
    sides = np.minimum(a[:, None, 2:], b[None, :, 2:]) - np.maximum(a[:, None, :2], b[None, :, :2])
    return np.asarray(np.prod(np.maximum(sides, 0.0), axis=2), np.float64)


def distance_bev(a: Array, b: Array) -> Float64:
    """Distance (N, M) [m] in the ground plane between centers (N, 2 or 3) and (M, 2 or 3)."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    return np.asarray(np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1]), np.float64)


def move_boxes(boxes: Boxes3D, dst_T_src: Float64) -> Boxes3D:
    """Move boxes from coordinate frame `src` to `dst`: centers, rotations and velocities (4, 4). A box that stands on
    end in `dst` has no unique yaw; it gets the one with roll 0.
    """
    from scipy.spatial.transform import Rotation  # takes a while to import

    zeros = np.zeros(len(boxes))
    angles = np.stack([boxes.yaw_rad, *(zeros if a is None else a for a in (boxes.pitch_rad, boxes.roll_rad))], axis=1)
    sane = np.isfinite(angles).all(axis=1)
    turned = np.full_like(angles, np.nan)
    if sane.any():
        src_R_box = Rotation.from_euler("ZYX", angles[sane])
        dst_R_box = Rotation.from_matrix(dst_T_src[:3, :3]) * src_R_box
        turned[sane] = dst_R_box.as_euler("ZYX", suppress_warnings=True)
    rotation = dst_T_src.copy()
    rotation[:3, 3] = 0
    velocity = None if boxes.velocity_mps is None else transform(rotation, boxes.velocity_mps)
    return replace(
        boxes, center_m=transform(dst_T_src, boxes.center_m), yaw_rad=turned[:, 0], pitch_rad=turned[:, 1],
        roll_rad=turned[:, 2], velocity_mps=velocity,
    )  # fmt: skip


def iou_bev(a: Boxes3D, b: Boxes3D) -> Float64:
    """Intersection over union (N, M) of the boxes' footprints, turned by yaw; roll and pitch are left out. 0 where a
    box has no area; -inf where one isn't finite or has a negative size.
    """
    return flat_iou(upright(a), upright(b), *_one_step(a, b), solid=False).reshape(len(a), len(b))


def flat_iou(a: Float64, b: Float64, start_a: Int64, start_b: Int64, solid: bool) -> Float64:
    """Intersection over union of the pairs of S steps, flat: step by step, row-major, one row a box of `a`.

    `a` (N, 7) and `b` (M, 7) are upright boxes: center x, y, z, length, width, height [m], heading [rad]; step s has
    rows `start_a[s]:start_a[s + 1]` of `a`, likewise of `b`. `solid`: in space; else of the footprints.
    """
    from fbench.replay.geometry.overlap_kernels import iou_blocks  # numba takes a while to import

    rows_a, rows_b = (np.ascontiguousarray(boxes, np.float64) for boxes in (a, b))
    return iou_blocks(rows_a, rows_b, comparable(a), comparable(b), start_a, start_b, solid)


def comparable(boxes: Float64) -> Bool:
    """Tell which upright boxes (N, 7) are finite and have no negative size."""
    finite: Bool = np.all(np.abs(np.nan_to_num(boxes, nan=np.inf)) < MAX_MAGNITUDE, axis=1)
    return np.asarray(finite & np.all(boxes[:, 3:6] >= 0, axis=1), np.bool_)


def upright(boxes: Boxes3D) -> Float64:
    """Center, size and heading (N, 7) of boxes."""
    return np.column_stack([boxes.center_m, boxes.size_lwh_m, boxes.yaw_rad])
