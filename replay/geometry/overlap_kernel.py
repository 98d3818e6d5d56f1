"""Compiled overlap of upright boxes with heading, for the pairs of many steps at once."""

import math

import numpy as np

from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.kernels import kernel

_ROOM = 20
"""Corners: a quadrangle cut by four lines has at most 8, if rounding bends it at most 19."""


@kernel
def iou_blocks(
    a: Float64, b: Float64, sound_a: Bool, sound_b: Bool, start_a: Int64, start_b: Int64, solid: bool
) -> Float64:
    """Intersection over union of all pairs of each step, flat: step by step, row-major.

    Args:
        a: (N, 7) centre x, y, z, length, width, height [m], heading [rad].
        b: (M, 7)
        sound_a: (N,) whether a box can be compared; if not, its similarity to all others is -inf.
        sound_b: (M,)
        start_a: (S + 1,) rows of each step in `a`.
        start_b: (S + 1,)
        solid: In space; else the footprints from above.
    """
    size = 0
    for s in range(len(start_a) - 1):
        size += (start_a[s + 1] - start_a[s]) * (start_b[s + 1] - start_b[s])
    result = np.zeros(size)
    room = np.empty((2, _ROOM, 2))
    reach_a, reach_b = np.hypot(a[:, 3], a[:, 4]) / 2, np.hypot(b[:, 3], b[:, 4]) / 2
    k = 0
    for s in range(len(start_a) - 1):
        for i in range(start_a[s], start_a[s + 1]):
            for j in range(start_b[s], start_b[s + 1]):
                if not (sound_a[i] and sound_b[j]):
                    result[k] = -np.inf
                elif (a[i, 0] - b[j, 0]) ** 2 + (a[i, 1] - b[j, 1]) ** 2 <= (reach_a[i] + reach_b[j]) ** 2:
                    result[k] = _iou(a[i], b[j], solid, room) if _before(a[i], b[j]) else _iou(b[j], a[i], solid, room)
                k += 1
    return result


@kernel
def _before(a: Float64, b: Float64) -> bool:
    """Whether `a` is the first of a pair: a pair gives the same whichever way round it comes."""
    for f in (3, 4, 0, 1, 6):
        if a[f] != b[f]:
            return bool(a[f] > b[f])
    return True


@kernel
def _iou(a: Float64, b: Float64, solid: bool, room: Float64) -> float:
    size_a, size_b = a[3] * a[4], b[3] * b[4]
    common = 0.0 if min(size_a, size_b) == 0.0 else min(size_a, size_b, _common_area(a, b, room))
    if solid:
        z = b[2] - a[2]
        height = min(a[5] / 2, z + b[5] / 2) - max(-a[5] / 2, z - b[5] / 2)
        common *= max(0.0, min(height, a[5], b[5]))
        size_a, size_b = size_a * a[5], size_b * b[5]
    if common <= 0.0:
        return 0.0
    iou: float = min(1.0, common / (size_a + size_b - common))
    return iou


@kernel
def _common_area(a: Float64, b: Float64, room: Float64) -> float:
    """Area in both footprints: b, seen from a, is cut along the sides of a (Sutherland and Hodgman, 1974).

    In a's own axes the cuts are exact, so that slivers and nearly equal boxes keep their digits.
    """
    x, y = b[0] - a[0], b[1] - a[1]
    cos, sin = math.cos(a[6]), math.sin(a[6])
    center_x, center_y = cos * x + sin * y, cos * y - sin * x
    turn = b[6] - a[6]
    cos, sin = math.cos(turn), math.sin(turn)
    for i, along, across in ((0, 0.5, 0.5), (1, -0.5, 0.5), (2, -0.5, -0.5), (3, 0.5, -0.5)):
        room[0, i, 0] = center_x + (cos * along * b[3] - sin * across * b[4])
        room[0, i, 1] = center_y + (sin * along * b[3] + cos * across * b[4])
    num = 4
    for side, axis, sign in ((0, 0, 1.0), (1, 0, -1.0), (0, 1, 1.0), (1, 1, -1.0)):
        num = _cut(room[side], num, axis, sign, a[3 + axis] / 2, room[1 - side])
    return _area(room[0], num)


@kernel
def _cut(corners: Float64, num: int, axis: int, sign: float, half: float, kept: Float64) -> int:
    """Keep the part of a polygon in which `sign` times a coordinate is at most `half`; returns its corners' number."""
    n = 0
    for i in range(num):
        before = num - 1 if i == 0 else i - 1
        depth, depth_before = half - sign * corners[i, axis], half - sign * corners[before, axis]
        if (depth >= 0.0) != (depth_before >= 0.0):
            share = depth_before / (depth_before - depth)
            other = 1 - axis
            kept[n, axis] = sign * half
            kept[n, other] = corners[before, other] + share * (corners[i, other] - corners[before, other])
            n += 1
        if depth >= 0.0:
            kept[n, 0], kept[n, 1] = corners[i, 0], corners[i, 1]
            n += 1
    return n


@kernel
def _area(corners: Float64, num: int) -> float:
    """Area of a polygon, counter-clockwise (shoelace formula)."""
    twice = 0.0
    for i in range(1, num - 1):
        x, y = corners[i, 0] - corners[0, 0], corners[i, 1] - corners[0, 1]
        twice += x * (corners[i + 1, 1] - corners[0, 1]) - (corners[i + 1, 0] - corners[0, 0]) * y
    return max(0.0, twice / 2)
