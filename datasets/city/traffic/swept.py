"""How long vehicles may be: long ones need room in curves, and must be able to go on for ever."""

import numpy as np

from fbench.datasets.city.traffic.state import AXLE
from fbench.datasets.city.world.city_map import Lane
from fbench.replay.arrays import Float64

_WIDTH_M = 2.55
"""Of trucks and buses (the European limit)."""
_INSIDE_M, _OUTSIDE_M = 0.15, 0.3
"""How far beyond its lane a body may reach."""
_SHORT_M, _STEP_M = 7.0, 0.25
"""All lanes are made for vehicles up to here."""


def usable_lengths(lanes: tuple[Lane, ...], along: list[Float64], tangents: list[Float64]) -> Float64:
    """Length (L,) of the longest vehicle that may use a lane, and that is never led to where it may not go on."""
    longest = np.array([_fitting(lane, a, t) for lane, a, t in zip(lanes, along, tangents, strict=True)])
    while True:
        onwards = np.array([max(longest[list(lane.successors)]) for lane in lanes])
        if (longest <= onwards).all():
            return longest
        longest = np.minimum(longest, onwards)


def _fitting(lane: Lane, along: Float64, tangent: Float64) -> float:
    cross = tangent[:-1, 0] * tangent[1:, 1] - tangent[:-1, 1] * tangent[1:, 0]
    bend = float(np.quantile(np.abs(np.arcsin(np.clip(cross, -1, 1))) / np.diff(along), 0.9))
    if lane.kind != "drive" or bend < 1e-3:
        return lane.longest_m
    return min(lane.longest_m, longest_in_curve(1 / bend, lane.width_m))


def longest_in_curve(radius_m: float, lane_m: float) -> float:
    """Length of the longest vehicle that, its axles on an arc, hardly leaves its lane.

    Its middle is on a circle of sqrt(R^2 - a^2) with the axles a before and behind it; the inner side reaches half its
    width inside, the front corners sqrt((r + w/2)^2 + (l/2)^2) outside.
    """
    length = np.arange(_SHORT_M, 25.0, _STEP_M)
    axles = np.minimum(AXLE * length, radius_m)
    middle = np.sqrt(radius_m**2 - axles**2)
    inner = middle - _WIDTH_M / 2 >= radius_m - lane_m / 2 - _INSIDE_M
    outer = np.hypot(middle + _WIDTH_M / 2, length / 2) <= radius_m + lane_m / 2 + _OUTSIDE_M
    return float(length[np.append(np.flatnonzero(~(inner & outer)), len(length) - 1)[0]])
