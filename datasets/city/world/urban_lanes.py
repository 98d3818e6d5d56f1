"""Drive, bike and walk lanes of the urban world, and places for parked cars.

The lane beside the kerb has it on its right; from it one turns right onto a crossing, and at its other side right
again into the lane beside the kerb there. So no two ways cross; they only part and join. The lane beside the houses
goes the other way and stays with its block.
"""

from collections.abc import Hashable

import numpy as np

from fbench.datasets.city.world.city_map import Draft, LaneKind, Parking, lift, round_corners, straight
from fbench.datasets.city.world.street_grid import BIKE_M, CORNER_M, LANE_M, PARKING_M, STOP_M, Arm, Grid
from fbench.replay.data.arrays import Float64

AVENUE_LONGEST_M = 7.0  # Longer vehicles stay off avenues: turning, they would swing into the lane beside them
BESIDE_BIKES_LONGEST_M = 8.0  # Longer vehicles don't turn left beside a bike lane: their rear would swing into it
_STREET_MPS, _AVENUE_MPS, _BIKE_MPS = 13.9, 13.9, 5.0
_LATERAL_MPS2 = 2.0  # Comfortable lateral acceleration in turns: v = sqrt(a R)
_ARC_END_M = 7.5  # Arcs end at most so far from the crossing street's lanes

Groups = dict[tuple[tuple[int, int], int], int]  # Signal groups of approaches by junction and arm


def drive_lanes(grid: Grid, groups: Groups) -> list[Draft]:
    """Lanes for motor vehicles: those that leave a junction by an arm, up to the next stop line, and turns."""
    links, turns = [], []
    for arm in grid.arm.values():
        far, num, avenue = grid.opposite(arm), arm.num_lanes, arm.num_lanes > 1
        speed = _AVENUE_MPS if avenue else _STREET_MPS
        exits = sorted((exit_.way, k, to) for exit_ in grid.arms(arm.far) for k, to in _pairs(far, exit_))
        links += [
            Draft(
                ("drive", arm.node, arm.way, k),
                lift(straight(arm.at(STOP_M, -lane_offset_m(k)), far.at(STOP_M, lane_offset_m(k))), 0.0),
                "drive", LANE_M, speed,
                tuple(("turn", far.node, far.way, k, way, to) for way, start, to in exits if start == k),
                left=("drive", arm.node, arm.way, k - 1) if k else None,
                right=("drive", arm.node, arm.way, k + 1) if k + 1 < num else None,
                signal=groups[far.node, far.way], longest_m=AVENUE_LONGEST_M if avenue else np.inf,
            )
            for k in range(num)
        ]  # fmt: skip
        for exit_ in grid.arms(arm.node):
            turn = (exit_.way - arm.way) % 4
            longest = BESIDE_BIKES_LONGEST_M if turn == 3 and arm.has_bikes else np.inf
            for k, to in _pairs(arm, exit_):
                offsets = lane_offset_m(k), lane_offset_m(to)
                wide = min(arm.edge_m + offsets[1], exit_.edge_m + offsets[0]) + _ARC_END_M
                radius = CORNER_M + LANE_M / 2 if turn == 1 else wide
                turns.append(Draft(
                    ("turn", arm.node, arm.way, k, exit_.way, to),
                    lift(turn_path(arm, exit_, offsets, radius), 0.0), "drive", LANE_M,
                    speed if turn == 2 else float(np.sqrt(_LATERAL_MPS2 * radius)),
                    (("drive", exit_.node, exit_.way, to),), in_junction=True,
                    longest_m=AVENUE_LONGEST_M if max(num, exit_.num_lanes) > 1 else longest,
                ))  # fmt: skip
    return links + turns


def bike_lanes(grid: Grid, groups: Groups) -> list[Draft]:
    """Lanes around blocks, turning right at each corner, inside of the drive lanes and of their right turns."""
    rings = [ring for cell, ring in zip(grid.cells, grid.rings, strict=False) if cell in grid.bikes]
    return [lane for ring in rings for k in range(len(ring)) for lane in _bike(grid, ring, k, groups)]


def lane_offset_m(k: int) -> float:
    """From the street's middle to the middle of its k-th lane from there."""
    return (k + 0.5) * LANE_M


def turn_path(approach: Arm, exit_: Arm, offsets_m: tuple[float, float], radius_m: float) -> Float64:
    """Way (P, 2) from one arm's stop line through the junction to the other's, between lanes at these offsets."""
    start, end = approach.at(STOP_M, offsets_m[0]), exit_.at(STOP_M, -offsets_m[1])
    if (exit_.way - approach.way) % 4 == 2:
        return straight(start, end)
    corner = approach.origin_m + offsets_m[0] * approach.left - offsets_m[1] * exit_.left
    return round_corners(np.array([start, corner, end]), [radius_m])


def _pairs(approach: Arm, exit_: Arm) -> list[tuple[int, int]]:
    """Which lane of an approach leads to which of an exit: straight on keeps lanes, turns use the outermost."""
    turn = (exit_.way - approach.way) % 4
    straight_on = [(k, k) for k in range(approach.num_lanes)]
    return [[], [(approach.num_lanes - 1, exit_.num_lanes - 1)], straight_on, [(0, 0)]][turn]


def _bike(grid: Grid, ring: list[Arm], k: int, groups: Groups) -> list[Draft]:
    """The lane along one side of a block, against the ring's direction, and the turn at its end."""
    arm, before = ring[k], ring[k - 1]
    start, exit_ = grid.opposite(arm), grid.arm[arm.node, (before.way + 2) % 4]
    offsets = arm.half_m + BIKE_M / 2, before.half_m + BIKE_M / 2
    radius, key = CORNER_M - BIKE_M / 2, (arm.node, arm.way)
    along = straight(start.at(STOP_M, -offsets[0]), arm.at(STOP_M, offsets[0]))
    turn = turn_path(arm, exit_, offsets, radius)
    turn_mps = float(np.sqrt(_LATERAL_MPS2 * radius))
    onto = ("bike turn", *key)
    return [
        Draft(("bike", *key), lift(along, 0.0), "bike", BIKE_M, _BIKE_MPS, (onto,), signal=groups[key]),
        Draft(onto, lift(turn, 0.0), "bike", BIKE_M, turn_mps, (("bike", before.node, before.way),), in_junction=True),
    ]


SIDEWALK_Z_M = 0.12
KERB_LANE_M, HOUSE_LANE_M = 1.15, 2.4  # Middle of the two lanes of a sidewalk of 3 m, from the kerb
CROSSING_M = (7.2, 10.8)  # Where along an arm people cross
OUTER_CORNER_M = 6.0  # Radius of the kerb at the world's corners
_THERE_M, _BACK_M = 8.2, 9.8  # Where along an arm people cross from its left to its right, and back
_TURN_M, _WAIT_M = 0.75, 0.3  # Radius of the turn onto a crossing; where they wait, from the kerb
_WALK: LaneKind = "walk"
_WIDTH_M, _SPEED_MPS = 1.0, 1.6


def walk_lanes(grid: Grid, groups: dict[tuple[int, int], int]) -> list[Draft]:
    """Lanes for pedestrians; `groups` are their signals by junction."""
    around = [lane for ring in grid.rings for k in range(len(ring)) for lane in _side(grid, ring, k)]
    for arm in grid.arm.values():  # two lanes over it, each with a turn onto it and one off it
        left, right = arm.left_kerb_m, -arm.right_kerb_m
        around += _one_way(arm, "there", (left, right), _THERE_M, groups[arm.node])
        around += _one_way(arm, "back", (right, left), _BACK_M, groups[arm.node])
    return around


def follow_kerb(before: Arm, after: Arm, inset_m: float, start_m: Float64, end_m: Float64) -> Float64:
    """Line (P, 2) at `inset_m` from the kerb of a ring, from one arm around the bend, if there is one, to the next."""
    if before.way == after.way:
        return straight(start_m, end_m)
    corner, radius = kerb_corner(before, after, inset_m)
    return round_corners(np.array([start_m, corner, end_m]), [radius])


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
    corner = follow_kerb(
        arm, after, KERB_LANE_M, end[-1], after.at(_THERE_M - _TURN_M, after.left_kerb_m + KERB_LANE_M)
    )
    # From beyond the far junction back along the arm to beyond its own.
    house, own = (one.at(CROSSING_M[1], one.left_kerb_m + HOUSE_LANE_M) for one in (after, arm))
    aside = follow_kerb(arm, after, HOUSE_LANE_M, house, own)
    on_there, on_back = ("on", after.node, after.way, "there"), ("on", far.node, far.way, "back")
    return [
        _walk(("near", *key), near, (("mid", *key),)),
        _walk(("mid", *key), mid, (("end", *key), on_back)),
        _walk(("end", *key), end, (("corner", *key),)),
        _walk(("corner", *key), corner, (("near", after.node, after.way), on_there)),
        _walk(("house", *key), aside, (("house", ring[k - 1].node, ring[k - 1].way),)),
    ]


def _one_way(arm: Arm, name: str, kerbs_m: tuple[float, float], along_m: float, group: int) -> list[Draft]:
    """From the kerb at one offset to that at the other; `there` turns from outwards, `back` from inwards."""
    away = 1.0 if kerbs_m[0] > kerbs_m[1] else -1.0
    before, key = along_m - away * _TURN_M, (arm.node, arm.way, name)
    lane, wait = kerbs_m[0] + away * KERB_LANE_M, kerbs_m[0] + away * _WAIT_M
    go, leave = kerbs_m[1] - away * _WAIT_M, kerbs_m[1] - away * KERB_LANE_M
    on = round_corners(np.array([arm.at(before, lane), arm.at(along_m, lane), arm.at(along_m, wait)]), [_TURN_M])
    off = round_corners(np.array([arm.at(along_m, go), arm.at(along_m, leave), arm.at(before, leave)]), [_TURN_M])
    # A crossing begins and ends on the sidewalks, and is on the road from 0.2 m beyond the kerbs.
    way = off[0] - on[-1]
    total = float(np.sqrt((way * way).sum()))
    stops = np.array([0.0, _WAIT_M - 0.05, _WAIT_M + 0.2])
    rest = np.linspace(_WAIT_M + 0.2, total - _WAIT_M - 0.2, int(np.ceil(total - 2 * _WAIT_M - 0.4)) + 1)
    s = np.concatenate([stops, rest[1:-1], total - stops[::-1]])
    z = np.where((s < _WAIT_M) | (s > total - _WAIT_M), SIDEWALK_Z_M, 0.0)
    over = lift(on[-1] + way * (s / total)[:, None], z)
    onto: Hashable = ("mid", arm.node, arm.way) if name == "back" else ("corner", arm.far, (arm.way + 2) % 4)
    return [
        _walk(("on", *key), on, (("over", *key),), group),
        Draft(("over", *key), over, _WALK, _WIDTH_M, _SPEED_MPS, (("off", *key),), in_junction=True),
        _walk(("off", *key), off, (onto,)),
    ]


def _walk(key: Hashable, points_m: Float64, successors: tuple[Hashable, ...], signal: int | None = None) -> Draft:
    return Draft(key, lift(points_m, SIDEWALK_Z_M), _WALK, _WIDTH_M, _SPEED_MPS, successors, signal=signal)


SPACE_M = 5.6
_FROM_M = 14.5  # Along an arm; nearer to the junction, parked cars would hide people who cross


def parkings(grid: Grid) -> tuple[Parking, ...]:
    """All places; cars stand with the traffic beside them."""
    places = []
    for arm in grid.arm.values():
        for start, end in spaces_m(arm, grid.opposite(arm)):
            x, y = arm.at((start + end) / 2, arm.left_kerb_m - PARKING_M / 2)
            places.append(Parking((float(x), float(y), 0.0), float((arm.yaw_rad + np.pi) % (2 * np.pi)), SPACE_M))
    return tuple(places)


def spaces_m(arm: Arm, far: Arm) -> list[tuple[float, float]]:
    """Where along an arm the places on its left begin and end."""
    if arm.left_extra_m < PARKING_M:
        return []
    num = int((arm.length_to(far) - 2 * _FROM_M) / SPACE_M)
    start = (arm.length_to(far) - num * SPACE_M) / 2
    return [(start + k * SPACE_M, start + (k + 1) * SPACE_M) for k in range(num)]
