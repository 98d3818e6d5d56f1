"""Compiled overlap of rectangles and of upright boxes with heading, and motion of many points."""

import math

import numpy as np

from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.geometry.kernels import kernel, kernel_part

_ROOM = 20  # Corners: a quadrangle cut by four lines has at most 8, if rounding bends it at most 19


@kernel
def rectangle_blocks(
    a: Float64, b: Float64, sound_a: Bool, sound_b: Bool, start_a: Int64, start_b: Int64, region: Bool
) -> Float64:
    """Intersection over union of the pairs of S steps, flat, of rectangles (N, 4) and (M, 4): left, top, right, bottom.

    Where `region` (N,): intersection over the area of the second. 0 where that is 0; -inf where one isn't sound.
    """
    size, k = 0, 0
    for s in range(len(start_a) - 1):
        size += (start_a[s + 1] - start_a[s]) * (start_b[s + 1] - start_b[s])
    result = np.empty(size)
    for s in range(len(start_a) - 1):
        for i in range(start_a[s], start_a[s + 1]):
            area_a = max(a[i, 2] - a[i, 0], 0.0) * max(a[i, 3] - a[i, 1], 0.0)
            for j in range(start_b[s], start_b[s + 1]):
                result[k] = 0.0 if sound_a[i] and sound_b[j] else -np.inf
                width = max(min(a[i, 2], b[j, 2]) - max(a[i, 0], b[j, 0]), 0.0)
                height = max(min(a[i, 3], b[j, 3]) - max(a[i, 1], b[j, 1]), 0.0)
                common = width * height
                area_b = max(b[j, 2] - b[j, 0], 0.0) * max(b[j, 3] - b[j, 1], 0.0)
                whole = area_b if region[i] else area_a + area_b - common
                if whole > 0.0 and sound_a[i] and sound_b[j]:
                    result[k] = common / whole
                k += 1
    return result


@kernel
def iou_blocks(
    a: Float64, b: Float64, sound_a: Bool, sound_b: Bool, start_a: Int64, start_b: Int64, solid: bool
) -> Float64:
    """Intersection over union as of `iou.flat_iou`; `sound_a` (N,) and `sound_b` (M,) tell which boxes can be compared:
    the similarity of others to all is -inf.
    """
    size = 0
    for s in range(len(start_a) - 1):
        size += (start_a[s + 1] - start_a[s]) * (start_b[s + 1] - start_b[s])
    result, room, k = np.empty(size), np.empty((2, _ROOM, 2)), 0
    reach_b = np.empty(len(b))
    for j in range(len(b)):
        reach_b[j] = math.hypot(b[j, 3], b[j, 4]) / 2
    for s in range(len(start_a) - 1):
        for i in range(start_a[s], start_a[s + 1]):
            reach_a = math.hypot(a[i, 3], a[i, 4]) / 2
            for j in range(start_b[s], start_b[s + 1]):
                x, y, reach = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], reach_a + reach_b[j]
                if not (sound_a[i] and sound_b[j]):
                    result[k] = -np.inf
                elif x * x + y * y <= reach * reach:
                    result[k] = _iou(a[i], b[j], solid, room)
                else:
                    result[k] = 0.0
                k += 1
    return result


@kernel_part
def _iou(one: Float64, other: Float64, solid: bool, room: Float64) -> float:
    """A pair gives the same whichever way round it comes: the larger box is the first."""
    k = 3
    for f in (4, 0, 1, 6):
        if one[k] == other[k]:
            k = f
    a, b = (one, other) if one[k] >= other[k] else (other, one)
    size_a, size_b = a[3] * a[4], b[3] * b[4]
    common = min(size_a, size_b)
    if common > 0.0:
        common = min(common, _common_area(a, b, room))
    if solid:
        z = b[2] - a[2]
        height = min(a[5] / 2, z + b[5] / 2) - max(-a[5] / 2, z - b[5] / 2)
        common *= max(0.0, min(height, min(a[5], b[5])))  # noqa: PLW3301  # numba compiles more for three arguments
        size_a, size_b = size_a * a[5], size_b * b[5]
    if common <= 0.0:
        return 0.0
    iou: float = min(1.0, common / (size_a + size_b - common))
    return iou


@kernel_part
def _common_area(a: Float64, b: Float64, room: Float64) -> float:
    """Area in both footprints: b, seen from a, is cut along the sides of a (Sutherland and Hodgman, 1974). In a's own
    axes the cuts are exact, so that slivers and nearly equal boxes keep their digits.
    """
    x, y = b[0] - a[0], b[1] - a[1]
    cos, sin = math.cos(a[6]), math.sin(a[6])
    center_x, center_y = cos * x + sin * y, cos * y - sin * x
    turn = b[6] - a[6]
    cos, sin = math.cos(turn), math.sin(turn)
    num = 0
    for _ in range(4):  # counter-clockwise
        along, across = 0.5 if num in (0, 3) else -0.5, 0.5 if num < 2 else -0.5
        room[0, num, 0] = center_x + (cos * along * b[3] - sin * across * b[4])
        room[0, num, 1] = center_y + (sin * along * b[3] + cos * across * b[4])
        num += 1
    for side in range(4):
        old, new, axis, sign = side % 2, 1 - side % 2, side // 2, 1.0 - 2.0 * (side % 2)
        half, kept = a[3 + axis] / 2, 0
        for i in range(num):  # keep where `sign` times the coordinate is at most `half`
            before = num - 1 if i == 0 else i - 1
            depth, depth_before = half - sign * room[old, i, axis], half - sign * room[old, before, axis]
            if (depth >= 0.0) != (depth_before >= 0.0):
                share, across_axis = depth_before / (depth_before - depth), 1 - axis
                start = room[old, before, across_axis]
                room[new, kept, axis] = sign * half
                room[new, kept, across_axis] = start + share * (room[old, i, across_axis] - start)
                kept += 1
            if depth >= 0.0:
                room[new, kept, 0], room[new, kept, 1] = room[old, i, 0], room[old, i, 1]
                kept += 1
        num = kept
    twice = 0.0  # shoelace formula
    for i in range(1, num - 1):
        x, y = room[0, i, 0] - room[0, 0, 0], room[0, i, 1] - room[0, 0, 1]
        twice += x * (room[0, i + 1, 1] - room[0, 0, 1]) - (room[0, i + 1, 0] - room[0, 0, 0]) * y
    return max(0.0, twice / 2)


@kernel
def move_points(m: Float64, xyz: Array) -> Float64:
    """Move points (N, 3) by a matrix (4, 4), bit by bit as `transform` does it on whole columns."""
    result = np.empty((len(xyz), 3))
    for row in range(len(xyz)):
        x, y, z = np.float64(xyz[row, 0]), np.float64(xyz[row, 1]), np.float64(xyz[row, 2])
        for i in range(3):
            result[row, i] = x * m[i, 0] + y * m[i, 1] + z * m[i, 2] + m[i, 3]
    return result
