"""Compiled motion of points that were measured one after the other from a moving body."""

import math

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.kernels import kernel

_SMALL = 1e-3
"""Below this angle [rad] series are more exact than quotients."""


@kernel
def carried(xyz: Float64, time_s: Float64, turn_radps: Float64, speed_mps: Float64) -> Float64:
    """Move points (N, 3) [m], each in body coordinates at its time (N,), to body coordinates at time 0.

    The body turns (3,) and moves (3,) steadily in its own axes: p -> R p + V v t with W = [w]x, a = |w| t,
    R = I + sin(a) / |w| W + (1 - cos(a)) / |w|^2 W^2 and V t = t I + (1 - cos(a)) / |w|^2 W + (a - sin(a)) / |w|^3 W^2
    (exponential of a twist: Murray, Li, Sastry, A Mathematical Introduction to Robotic Manipulation, 1994, 2.3).
    """
    result = np.empty_like(xyz)
    rate = math.sqrt(turn_radps[0] ** 2 + turn_radps[1] ** 2 + turn_radps[2] ** 2)
    move = np.zeros((3, 4))
    before = 0.0
    for i in range(len(xyz)):
        if time_s[i] == 0.0:
            result[i] = xyz[i]
            continue
        if time_s[i] != before:  # beams of one shot share it
            before = time_s[i]
            _fill(move, before, rate, turn_radps, speed_mps)
        x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
        for axis in range(3):
            result[i, axis] = move[axis, 0] * x + move[axis, 1] * y + move[axis, 2] * z + move[axis, 3]
    return result


@kernel
def _fill(move: Float64, t: float, rate: float, turn: Float64, speed: Float64) -> None:
    """Write R and V v t into `move` (3, 4)."""
    a = rate * t
    if abs(a) < _SMALL:
        first, second, third = t * (1 - a * a / 6), t * t * (0.5 - a * a / 24), t**3 * (1 / 6 - a * a / 120)
    else:
        first, second = math.sin(a) / rate, 2 * (math.sin(a / 2) / rate) ** 2
        third = (a - math.sin(a)) / rate**3
    square = turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2
    for axis in range(3):
        j, k = (axis + 1) % 3, (axis + 2) % 3
        move[axis, axis] = 1 + second * (turn[axis] ** 2 - square)
        move[axis, j] = second * turn[axis] * turn[j] - first * turn[k]
        move[axis, k] = second * turn[axis] * turn[k] + first * turn[j]
        across = turn[j] * speed[k] - turn[k] * speed[j]  # W v
        along = turn[0] * speed[0] + turn[1] * speed[1] + turn[2] * speed[2]
        move[axis, 3] = t * speed[axis] + second * across + third * (turn[axis] * along - square * speed[axis])
