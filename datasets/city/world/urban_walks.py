"""Walk lanes of the urban world: along the kerbs of every block in both directions, and over every arm of a junction.

The lane beside the kerb has it on its right; from it one turns right onto a crossing, and at its other side right
again into the lane beside the kerb there. So no two ways cross; they only part and join. The lane beside the houses
goes the other way and stays with its block.
"""

from collections.abc import Hashable

import numpy as np

from fbench.datasets.city.world.city_map import LaneKind
from fbench.datasets.city.world.lane_graph import Draft
from fbench.datasets.city.world.lane_paths import lifted, rounded, straight
from fbench.datasets.city.world.street_grid import CORNER_M, Arm, Grid
from fbench.replay.arrays import Float64

SIDEWALK_Z_M = 0.12
KERB_LANE_M, HOUSE_LANE_M = 1.15, 2.4
"""Middle of the two lanes of a sidewalk of 3 m, from the kerb."""
CROSSING_M = (7.2, 10.8)
"""Where along an arm people cross."""
OUTER_CORNER_M = 6.0
"""Radius of the kerb at the world's corners."""
_THERE_M, _BACK_M = 8.2, 9.8
"""Where along an arm people cross from its left to its right, and back."""
_TURN_M, _WAIT_M = 0.75, 0.3
"""Radius of the turn onto a crossing; where they wait, from the kerb."""
_WALK: LaneKind = "walk"
_WIDTH_M, _SPEED_MPS = 1.0, 1.6


def walk_lanes(grid: Grid, groups: dict[tuple[int, int], int]) -> list[Draft]:
    """Lanes for pedestrians; `groups` are their signals by junction."""
    around = [lane for ring in grid.rings for k in range(len(ring)) for lane in _side(grid, ring, k)]
    return around + [lane for arm in grid.arm.values() for lane in _crossing(arm, groups[arm.node])]


def kerb_corner(before: Arm, after: Arm, inset_m: float) -> tuple[Float64, float]:
    """Where a ring's line at `inset_m` from the kerb bends from one arm to the next (2,), and with which radius."""
    corner = after.origin_m + (before.left_kerb_m + inset_m) * before.left + (after.left_kerb_m + inset_m) * after.left
    if (after.way - before.way) % 4 == 1:
        return corner, max(CORNER_M - max(before.left_extra_m, after.left_extra_m) - inset_m, 0.6)
    return corner, OUTER_CORNER_M + inset_m


def _side(grid: Grid, ring: list[Arm], k: int) -> list[Draft]:
    """Lanes from the junction where a ring's arm begins to beyond the junction where it ends."""
    arm, after = ring[k], ring[(k + 1) % len(ring)]
    far = grid.opposite(arm)
    o = arm.left_kerb_m + KERB_LANE_M
    key = (arm.node, arm.way)
    near = straight(arm.at(_THERE_M - _TURN_M, o), arm.at(_BACK_M + _TURN_M, o))
    mid = straight(near[-1], far.at(_BACK_M + _TURN_M, -o))
    end = straight(mid[-1], far.at(_THERE_M - _TURN_M, -o))
    on_there, on_back = ("on", after.node, after.way, "there"), ("on", far.node, far.way, "back")
    return [
        _walk(("near", *key), near, (("mid", *key),)),
        _walk(("mid", *key), mid, (("end", *key), on_back)),
        _walk(("end", *key), end, (("corner", *key),)),
        _walk(("corner", *key), _around(arm, after, end[-1]), (("near", after.node, after.way), on_there)),
        _walk(("house", *key), _house_side(ring, k), (("house", ring[k - 1].node, ring[k - 1].way),)),
    ]


def _around(arm: Arm, after: Arm, start_m: Float64) -> Float64:
    end = after.at(_THERE_M - _TURN_M, after.left_kerb_m + KERB_LANE_M)
    if after.way == arm.way:
        return straight(start_m, end)
    corner, radius = kerb_corner(arm, after, KERB_LANE_M)
    return rounded(np.array([start_m, corner, end]), [radius])


def _house_side(ring: list[Arm], k: int) -> Float64:
    """From beyond the far junction back along the arm to beyond its own."""
    arm, after = ring[k], ring[(k + 1) % len(ring)]
    start, end = _house_point(after), _house_point(arm)
    if after.way == arm.way:
        return straight(start, end)
    corner, radius = kerb_corner(arm, after, HOUSE_LANE_M)
    return rounded(np.array([start, corner, end]), [radius])


def _house_point(arm: Arm) -> Float64:
    return arm.at(CROSSING_M[1], arm.left_kerb_m + HOUSE_LANE_M)


def _crossing(arm: Arm, group: int) -> list[Draft]:
    """Two lanes over an arm, each with a turn onto it and one off it."""
    left, right = arm.left_kerb_m, -arm.right_kerb_m
    return [
        *_one_way(arm, "there", (left, right), _THERE_M, group),
        *_one_way(arm, "back", (right, left), _BACK_M, group),
    ]


def _one_way(arm: Arm, name: str, kerbs_m: tuple[float, float], along_m: float, group: int) -> list[Draft]:
    """From the kerb at one offset to that at the other; `there` turns from outwards, `back` from inwards."""
    away = 1.0 if kerbs_m[0] > kerbs_m[1] else -1.0
    before, key = along_m - away * _TURN_M, (arm.node, arm.way, name)
    lane, wait = kerbs_m[0] + away * KERB_LANE_M, kerbs_m[0] + away * _WAIT_M
    go, leave = kerbs_m[1] - away * _WAIT_M, kerbs_m[1] - away * KERB_LANE_M
    on = rounded(np.array([arm.at(before, lane), arm.at(along_m, lane), arm.at(along_m, wait)]), [_TURN_M])
    off = rounded(np.array([arm.at(along_m, go), arm.at(along_m, leave), arm.at(before, leave)]), [_TURN_M])
    over = straight(on[-1], off[0])
    onto: Hashable = ("mid", arm.node, arm.way) if name == "back" else ("corner", arm.far, (arm.way + 2) % 4)
    return [
        _walk(("on", *key), on, (("over", *key),), group),
        Draft(("over", *key), _stepped(over), _WALK, _WIDTH_M, _SPEED_MPS, (("off", *key),), in_junction=True),
        _walk(("off", *key), off, (onto,)),
    ]


def _stepped(over_m: Float64) -> Float64:
    """A crossing begins and ends on the sidewalks, and is on the road from 0.2 m beyond the kerbs."""
    way = over_m[-1] - over_m[0]
    total = float(np.sqrt((way * way).sum()))
    stops = np.array([0.0, _WAIT_M - 0.05, _WAIT_M + 0.2])
    rest = np.linspace(_WAIT_M + 0.2, total - _WAIT_M - 0.2, int(np.ceil(total - 2 * _WAIT_M - 0.4)) + 1)
    s = np.concatenate([stops, rest[1:-1], total - stops[::-1]])
    z = np.where((s < _WAIT_M) | (s > total - _WAIT_M), SIDEWALK_Z_M, 0.0)
    return lifted(over_m[0] + way * (s / total)[:, None], z)


def _walk(key: Hashable, points_m: Float64, successors: tuple[Hashable, ...], signal: int | None = None) -> Draft:
    return Draft(key, lifted(points_m, SIDEWALK_Z_M), _WALK, _WIDTH_M, _SPEED_MPS, successors, signal=signal)
