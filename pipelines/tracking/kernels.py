"""Compiled loops of tracking: overlaps, hulls and the steps of the filters."""

import math

import numpy as np

from fbench.replay.data.arrays import Array, Float64
from fbench.replay.geometry.kernels import kernel, kernel_part


def one_layout(values: Array) -> Float64:
    """Copy to the one kind of array for which the kernels are compiled once."""
    return np.array(values, np.float64, order="C")


@kernel
def hull_areas(a: Float64, b: Float64) -> Float64:
    """Area (N, M) [m^2] of the convex hull of each pair of footprints, by A. M. Andrew's monotone chain (1979).

    Boxes (N, 7) and (M, 7) are center x, y, z, length, width, height [m], heading [rad].
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
def generalize_iou(a: Float64, b: Float64, iou: Float64) -> Float64:
    """Generalized IoU (N, M) of upright boxes in space: IoU - 1 + union / hull; -1 where a hull isn't finite, or empty.

    Takes boxes as `hull_areas` does, and their IoU (N, M) in space, -inf where they can't be compared.
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


@kernel_part
def _corners(box: Float64, origin: Float64, points: Float64, start: int) -> None:
    """Write four corners, seen from another box's center so that far boxes keep their digits."""
    cos, sin = math.cos(box[6]), math.sin(box[6])
    x, y = box[0] - origin[0], box[1] - origin[1]
    for k in range(4):
        along = box[3] / 2 if k < 2 else -box[3] / 2
        across = box[4] / 2 if k % 2 == 0 else -box[4] / 2
        points[start + k, 0] = x + cos * along - sin * across
        points[start + k, 1] = y + sin * along + cos * across


@kernel_part
def _sort(points: Float64) -> None:
    for i in range(1, len(points)):
        x, y = points[i, 0], points[i, 1]
        k = i
        while k > 0 and (points[k - 1, 0] > x or (points[k - 1, 0] == x and points[k - 1, 1] > y)):
            points[k, 0], points[k, 1] = points[k - 1, 0], points[k - 1, 1]
            k -= 1
        points[k, 0], points[k, 1] = x, y


@kernel_part
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


@kernel_part
def _turn(chain: Float64, num: int, point: Float64) -> float:
    """Positive where the way over the last two corners to `point` turns left."""
    x, y = chain[num - 1, 0] - chain[num - 2, 0], chain[num - 1, 1] - chain[num - 2, 1]
    turn: float = x * (point[1] - chain[num - 2, 1]) - y * (point[0] - chain[num - 2, 0])
    return turn


@kernel
def predict_states(values: Float64, dt_s: float, dt_s2: float, dt_s3: float, drift_std: Float64) -> Float64:
    """Move states (5, T, m) by `dt_s`, whose powers come along, with the rates' drift (T, m) in one second."""
    result = np.empty_like(values)
    for t in range(values.shape[1]):
        for k in range(values.shape[2]):
            place, rate = values[0, t, k], values[1, t, k]
            place_var, covariance, rate_var = values[2, t, k], values[3, t, k], values[4, t, k]
            q = drift_std[t, k] * drift_std[t, k]
            shared = dt_s * covariance
            result[0, t, k] = place + dt_s * rate
            result[1, t, k] = rate
            result[2, t, k] = place_var + shared + shared + dt_s * rate_var * dt_s + q * dt_s3 / 3
            result[3, t, k] = covariance + dt_s * rate_var + q * dt_s2 / 2
            result[4, t, k] = rate_var + q * dt_s
    return result


@kernel
def correct_states(values: Float64, measured: Float64, measured_std: Float64) -> Float64:
    """Correct states (5, T, m) with one measurement each (T, m), its standard deviation likewise."""
    result = np.empty_like(values)
    for t in range(values.shape[1]):
        for k in range(values.shape[2]):
            place, rate = values[0, t, k], values[1, t, k]
            place_var, covariance, rate_var = values[2, t, k], values[3, t, k], values[4, t, k]
            weight = np.divide(1.0, place_var + measured_std[t, k] * measured_std[t, k])
            gain, rate_gain, apart = place_var * weight, covariance * weight, measured[t, k] - place
            result[0, t, k] = place + gain * apart
            result[1, t, k] = rate + rate_gain * apart
            result[2, t, k] = place_var - gain * place_var
            # Both are the same but for rounding: so the block stays symmetric.
            result[3, t, k] = (covariance - gain * covariance + (covariance - rate_gain * place_var)) / 2
            result[4, t, k] = rate_var - rate_gain * covariance
    return result


@kernel
def as_measured(xyxy: Float64, least: float) -> Float64:
    """Center x, y, area and aspect ratio (N, 4) of left, top, right, bottom (N, 4); sides are `least` at least."""
    result = np.empty((len(xyxy), 4))
    for i in range(len(xyxy)):
        # Not `max`, which may make a side of what isn't a number.
        across, down = np.maximum(xyxy[i, 2] - xyxy[i, 0], least), np.maximum(xyxy[i, 3] - xyxy[i, 1], least)
        result[i, 0], result[i, 1] = (xyxy[i, 0] + xyxy[i, 2]) / 2, (xyxy[i, 1] + xyxy[i, 3]) / 2
        result[i, 2], result[i, 3] = across * down, np.divide(across, down)
    return result


@kernel
def as_corners(measured: Float64) -> Float64:
    """Left, top, right, bottom (N, 4) of center, area and aspect ratio (N, 4)."""
    result = np.empty((len(measured), 4))
    for i in range(len(measured)):
        x, y, area, aspect = measured[i, 0], measured[i, 1], measured[i, 2], measured[i, 3]
        across, down = np.sqrt(area * aspect) / 2, np.sqrt(np.divide(area, aspect)) / 2
        result[i, 0], result[i, 1], result[i, 2], result[i, 3] = x - across, y - down, x + across, y + down
    return result
