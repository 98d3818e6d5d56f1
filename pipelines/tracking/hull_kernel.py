"""Compiled area of the smallest convex outline around two footprints."""

import math

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.kernels import kernel


@kernel
def hull_areas(a: Float64, b: Float64) -> Float64:
    """Area (N, M) [m^2] of the convex hull of each pair of footprints, by A. M. Andrew's monotone chain (1979).

    Args:
        a: (N, 7) centre x, y, z, length, width, height [m], heading [rad].
        b: (M, 7)
    """
    areas = np.empty((len(a), len(b)))
    points, chain = np.empty((8, 2)), np.empty((17, 2))
    for i in range(len(a)):
        for j in range(len(b)):
            _corners(a[i], a[i], points, 0)
            _corners(b[j], a[i], points, 4)
            _sort(points)
            areas[i, j] = _hull_area(points, chain)
    return areas


@kernel
def generalised(a: Float64, b: Float64, iou: Float64) -> Float64:
    """Generalised IoU (N, M) of upright boxes in space: IoU - 1 + union / hull; -1 where a hull isn't finite, or empty.

    Args:
        a: (N, 7) centre x, y, z, length, width, height [m], heading [rad].
        b: (M, 7)
        iou: (N, M) in space, -inf where boxes can't be compared.
    """
    result = hull_areas(a, b)
    for i in range(len(a)):
        for j in range(len(b)):
            common = max(iou[i, j], 0.0)
            union = (a[i, 3] * a[i, 4] * a[i, 5] + b[j, 3] * b[j, 4] * b[j, 5]) / (1.0 + common)
            top = max(a[i, 2] + a[i, 5] / 2, b[j, 2] + b[j, 5] / 2)
            bottom = min(a[i, 2] - a[i, 5] / 2, b[j, 2] - b[j, 5] / 2)
            hull = result[i, j] * (top - bottom)
            if math.isfinite(hull) and hull > 0.0 and math.isfinite(union):
                result[i, j] = min(1.0, max(-1.0, common - 1.0 + union / hull))
            else:
                result[i, j] = -1.0
    return result


@kernel
def _corners(box: Float64, origin: Float64, points: Float64, start: int) -> None:
    """Write four corners, seen from another box's centre so that far boxes keep their digits."""
    cos, sin = math.cos(box[6]), math.sin(box[6])
    x, y = box[0] - origin[0], box[1] - origin[1]
    for k in range(4):
        along = box[3] / 2 if k < 2 else -box[3] / 2
        across = box[4] / 2 if k % 2 == 0 else -box[4] / 2
        points[start + k, 0] = x + cos * along - sin * across
        points[start + k, 1] = y + sin * along + cos * across


@kernel
def _sort(points: Float64) -> None:
    """By x, then y."""
    for i in range(1, len(points)):
        x, y = points[i, 0], points[i, 1]
        k = i
        while k > 0 and (points[k - 1, 0] > x or (points[k - 1, 0] == x and points[k - 1, 1] > y)):
            points[k, 0], points[k, 1] = points[k - 1, 0], points[k - 1, 1]
            k -= 1
        points[k, 0], points[k, 1] = x, y


@kernel
def _hull_area(points: Float64, chain: Float64) -> float:
    """Area of the hull of sorted points: the lower outline, then the upper one back."""
    num, total, turn = 0, len(points), 2
    for step in range(2 * total - 1):
        i = step if step < total else 2 * total - 2 - step
        least = 2 if step < total else turn
        while num >= least and _turn(chain, num, points[i]) <= 0.0:
            num -= 1
        chain[num, 0], chain[num, 1] = points[i, 0], points[i, 1]
        num += 1
        if step == total - 1:
            turn = num + 1
    twice = 0.0
    for i in range(1, num - 1):
        x, y = chain[i, 0] - chain[0, 0], chain[i, 1] - chain[0, 1]
        twice += x * (chain[i + 1, 1] - chain[0, 1]) - (chain[i + 1, 0] - chain[0, 0]) * y
    return max(0.0, twice / 2)


@kernel
def _turn(chain: Float64, num: int, point: Float64) -> float:
    """Positive where the way over the last two corners to `point` turns left."""
    x, y = chain[num - 1, 0] - chain[num - 2, 0], chain[num - 1, 1] - chain[num - 2, 1]
    turn: float = x * (point[1] - chain[num - 2, 1]) - y * (point[0] - chain[num - 2, 0])
    return turn
