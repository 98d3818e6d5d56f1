"""Compiled similarity of all pairs of many steps: centers, nearest faces; and selection among pairs."""

import math

import numpy as np

from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.geometry.kernels import kernel, kernel_part


@kernel
def distance_blocks(
    a: Float64, b: Float64, sound_a: Bool, sound_b: Bool, start_a: Int64, start_b: Int64, block_start: Int64
) -> Float64:
    """Negated distance between points (N, D) and (M, D)."""
    result = np.empty(block_start[-1])
    for s in range(len(block_start) - 1):
        k = block_start[s]
        for i in range(start_a[s], start_a[s + 1]):
            for j in range(start_b[s], start_b[s + 1]):
                total = 0.0
                for axis in range(a.shape[1]):
                    total += (a[i, axis] - b[j, axis]) ** 2
                result[k] = -math.sqrt(total) if sound_a[i] and sound_b[j] else -np.inf
                k += 1
    return result


@kernel
def plane_blocks(
    a: Float64, b: Float64, sound_a: Bool, sound_b: Bool, start_a: Int64, start_b: Int64, block_start: Int64,
    ego: Float64,
) -> Float64:  # fmt: skip
    """Negated distance between the sides that the ego at (S, 2) sees: boxes (N, 7) and (M, 7), the first are truth."""
    result = np.empty(block_start[-1])
    for s in range(len(block_start) - 1):
        k = block_start[s]
        for i in range(start_a[s], start_a[s + 1]):
            for j in range(start_b[s], start_b[s + 1]):
                result[k] = -_plane_distance(a[i], b[j], ego[s]) if sound_a[i] and sound_b[j] else -np.inf
                k += 1
    return result


@kernel_part
def _plane_distance(truth: Float64, estimate: Float64, ego: Float64) -> float:
    """Root mean square of the distances of two corners of truth, the nearest to the ego, from those of the estimate.

    In the box's own axes the nearest corner is the one on the ego's side along both, and the next lies across the
    width if `|x| length >= |y| width`, with the ego at (x, y).
    """
    cos, sin = math.cos(truth[6]), math.sin(truth[6])
    x, y = ego[0] - truth[0], ego[1] - truth[1]
    along, across = cos * x + sin * y, cos * y - sin * x
    side_x, side_y = (0.5 if along >= 0.0 else -0.5), (0.5 if across >= 0.0 else -0.5)
    end = abs(along) * truth[3] >= abs(across) * truth[4]
    turn = estimate[6] - truth[6]
    sign = 1.0 if math.cos(turn) >= 0.0 else -1.0  # headings more than 90 deg apart: the estimate is turned round
    cos_e, sin_e = sign * math.cos(estimate[6]), sign * math.sin(estimate[6])
    total = 0.0
    for flip in (1.0, -1.0):
        u = side_x if end else flip * side_x
        v = flip * side_y if end else side_y
        dx = estimate[0] - truth[0] + u * (cos_e * estimate[3] - cos * truth[3])
        dx -= v * (sin_e * estimate[4] - sin * truth[4])
        dy = estimate[1] - truth[1] + u * (sin_e * estimate[3] - sin * truth[3])
        dy += v * (cos_e * estimate[4] - cos * truth[4])
        total += dx * dx + dy * dy
    return math.sqrt(total / 2)


@kernel
def select_pairs(
    values: Float64, row_start: Int64, column_start: Int64, rows: Bool, columns: Bool, kept_start: Int64
) -> Float64:
    """Values of the pairs of which both row and column are marked; `kept_start` (S + 1,) is where each step's begin."""
    kept, k, end = np.empty(kept_start[-1]), 0, 0
    for s in range(len(row_start) - 1):
        for i in range(row_start[s], row_start[s + 1]):
            if not rows[i]:
                k += column_start[s + 1] - column_start[s]
                continue
            for j in range(column_start[s], column_start[s + 1]):
                if columns[j]:
                    kept[end] = values[k]
                    end += 1
                k += 1
    return kept


@kernel
def keep_pairs(values: Float64, row_start: Int64, column_start: Int64, rows: Bool, columns: Bool) -> Float64:
    """Values of the pairs of which row or column is marked, -inf of all others."""
    kept, k = np.empty(len(values)), 0
    for s in range(len(row_start) - 1):
        for i in range(row_start[s], row_start[s + 1]):
            for j in range(column_start[s], column_start[s + 1]):
                kept[k] = values[k] if rows[i] or columns[j] else -np.inf
                k += 1
    return kept
