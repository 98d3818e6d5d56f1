"""Smooth centre lines: straights and arcs as points that are close enough for everyone."""

import numpy as np

from fbench.replay.arrays import Float64

STEP_M = 1.0
"""Points are at most so far apart."""
TURN_RAD = 0.08
"""The heading changes by at most so much from one piece between two points to the next."""


def rounded(corners_m: Float64, radii_m: list[float]) -> Float64:
    """Follow a polyline (K, 2) whose K - 2 inner corners are rounded by arcs of these radii; returns points (P, 2).

    Raises:
        ValueError: where a straight is too short for the arcs at its ends.
    """
    start, pieces = corners_m[0], [corners_m[:1]]
    for a, b, c, radius in zip(corners_m[:-2], corners_m[1:-1], corners_m[2:], radii_m, strict=True):
        u, v = _unit(b - a), _unit(c - b)
        turn = float(np.arctan2(u[0] * v[1] - u[1] * v[0], u[0] * v[0] + u[1] * v[1]))
        reach = radius * np.tan(abs(turn) / 2)
        pieces += [_line(start, b - reach * u), _arc(b - reach * u, u, radius, turn)]
        if np.dot(b - reach * u - start, u) < -1e-9:
            raise ValueError(f"no room for an arc of {radius:g} m before {b}")
        start = b + reach * v
    if np.dot(corners_m[-1] - start, _unit(corners_m[-1] - corners_m[-2])) < -1e-9:
        raise ValueError(f"no room for an arc before {corners_m[-1]}")
    return np.concatenate([*pieces, _line(start, corners_m[-1])])


def straight(start_m: Float64, end_m: Float64) -> Float64:
    """Points (P, 2) from start to end."""
    return np.concatenate([start_m[None], _line(start_m, end_m)])


def lifted(points_m: Float64, z_m: float | Float64) -> Float64:
    """Give points (P, 2) a height: (P, 3)."""
    return np.column_stack([points_m, np.broadcast_to(np.asarray(z_m, np.float64), len(points_m))])


def sparse(points_m: Float64) -> Float64:
    """Drop points (P, 2) of an open line that lie on the straight between their neighbours."""
    before, after = points_m[1:-1] - points_m[:-2], points_m[2:] - points_m[1:-1]
    bend = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
    kept: Float64 = points_m[np.concatenate([[True], bend > 1e-6, [True]])]
    return kept


def length(points_m: Float64) -> float:
    """How long a line (P, D) is."""
    steps = np.diff(points_m, axis=0)
    return float(np.sqrt((steps * steps).sum(axis=1)).sum())


def _line(start: Float64, end: Float64) -> Float64:
    """Points after the start; none where there is no way."""
    way = end - start
    num = int(np.ceil(np.sqrt((way * way).sum()) / STEP_M - 1e-9))
    points: Float64 = start + way * (np.arange(1, num + 1) / max(num, 1))[:, None]
    return points


def _arc(start: Float64, ahead: Float64, radius: float, turn: float) -> Float64:
    """Points after the start of an arc that turns left by `turn` (right where it is negative)."""
    side = np.sign(turn)
    left = np.array([-ahead[1], ahead[0]]) * side
    num = int(np.ceil(max(abs(turn) * radius / STEP_M, abs(turn) / TURN_RAD) - 1e-9))
    angle = (np.arange(1, num + 1) * (abs(turn) / max(num, 1)))[:, None]
    points: Float64 = start + radius * (np.sin(angle) * ahead + (1 - np.cos(angle)) * left)
    return points


def _unit(vector: Float64) -> Float64:
    unit: Float64 = vector / np.sqrt((vector * vector).sum())
    return unit
