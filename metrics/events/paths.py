"""Road users in coordinates of the path that the ego drives: how far ahead, how far aside, in which direction."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.criticality.motion import Complex, EgoMotion, Motion
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.sequences import Steps

SPACING_M = 1.0  # Of the corners of a path
LENGTH_M = 60.0  # Of the path ahead; where the recording ends, it goes straight on


@dataclass(frozen=True, eq=False)
class PathPlaces:
    """N road users beside the path that the ego drives from the step of each on; NaN where a motion isn't known."""

    ahead_m: Float64  # (N,) along the path from the body's origin; below 0: behind
    aside_m: Float64  # (N,) distance from the path, positive to the left
    course_rad: Float64  # (N,) direction of motion against that of the path, -pi to pi
    heading_rad: Float64  # (N,) heading of the footprint, likewise


def place_on_paths(bodies: Motion, step: Int64, steps: Steps, ego: EgoMotion) -> PathPlaces:
    """Return where bodies (N,) are beside the ego's path, the recorded one; `ego` (S,) is the ego at each step."""
    n = len(step)
    ahead, aside, direction = np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan)
    turn = np.exp(1j * ego.yaw_rad)
    world = ego.place[step] + bodies.place * turn[step]
    starts = np.searchsorted(step, np.arange(len(steps) + 1))
    for stream in np.unique(steps.stream).tolist():
        own = np.flatnonzero((steps.stream == stream) & np.isfinite(ego.place) & np.isfinite(ego.yaw_rad))
        corners, passed = _thin(ego.place[own])
        for i, k in zip(own.tolist(), passed, strict=True):
            rows = slice(int(starts[i]), int(starts[i + 1]))
            if rows.start < rows.stop:
                last = int(own[-1])
                ahead[rows], aside[rows], direction[rows] = _project(
                    world[rows], _path(ego.place[i], corners[k:], turn[last])
                )
    yaw = ego.yaw_rad[step]
    course, heading = (_wrap(angle + yaw - direction) for angle in (bodies.course_rad, bodies.yaw_rad))
    return PathPlaces(ahead, aside, course, heading)


def _thin(places: Complex) -> tuple[Complex, list[int]]:
    """Corners (K,) of a path through places (S,), and how many of them lie behind each place or at it."""
    kept: list[complex] = []
    passed = []
    for place in places.tolist():
        if not kept or abs(place - kept[-1]) >= SPACING_M:
            kept.append(place)
        passed.append(len(kept))
    return np.array(kept, np.complex128), passed


def _path(begin: complex, corners: Complex, heading: complex) -> Complex:
    """Corners of a path of at least `LENGTH_M` from its begin on, along corners, then straight on along a heading."""
    ahead = corners[: int(LENGTH_M / SPACING_M)]
    path = np.concatenate([[begin], ahead[np.abs(ahead - begin) > SPACING_M / 2]])
    beyond = path[-1] - path[-2] if len(path) > 1 else heading
    return np.concatenate([path, [path[-1] + LENGTH_M * beyond / abs(beyond)]])


def _project(points: Complex, path: Complex) -> tuple[Float64, Float64, Float64]:
    """Way along the path [m], distance from it [m] and its direction, at the place of it nearest to each point."""
    side = np.diff(path)
    length = np.abs(side)
    unit = side / length
    offset = (points[:, None] - path[:-1]) * np.conj(unit)  # along and across each side
    low = np.zeros(len(side))
    low[0] = -np.inf  # behind the ego, too
    along = np.clip(offset.real, low, length)
    distance = np.hypot(offset.real - along, offset.imag)
    best = np.where(np.isfinite(distance), distance, np.inf).argmin(axis=1)
    at = np.arange(len(points)), best
    way = (np.cumsum(length) - length)[best] + along[at]
    return way, np.copysign(distance[at], offset.imag[at]), np.angle(unit)[best]


def _wrap(angle_rad: Float64) -> Float64:
    return np.asarray((angle_rad + np.pi) % (2 * np.pi) - np.pi)
