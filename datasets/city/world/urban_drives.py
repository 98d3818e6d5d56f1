"""Drive and bike lanes of the urban world: between junctions, and through them."""

import numpy as np

from fbench.datasets.city.world.lane_graph import Draft
from fbench.datasets.city.world.lane_paths import lifted, rounded, straight
from fbench.datasets.city.world.street_grid import BIKE_M, CORNER_M, LANE_M, STOP_M, Arm, Grid
from fbench.replay.arrays import Float64

AVENUE_LONGEST_M = 7.0
"""Longer vehicles stay off avenues: turning, they would swing into the lane beside them."""
BESIDE_BIKES_LONGEST_M = 8.0
"""Longer vehicles don't turn left beside a bike lane: their rear would swing into it."""
_STREET_MPS, _AVENUE_MPS, _BIKE_MPS = 13.9, 13.9, 5.0
_LATERAL_MPS2 = 2.0
"""Comfortable lateral acceleration in turns: v = sqrt(a R)."""
_ARC_END_M = 7.5
"""Arcs end at most so far from the crossing street's lanes."""

Groups = dict[tuple[tuple[int, int], int], int]
"""Signal groups of approaches by junction and arm."""


def drive_lanes(grid: Grid, groups: Groups) -> list[Draft]:
    """Lanes for motor vehicles."""
    links = [lane for arm in grid.arm.values() for lane in _links(grid, arm, groups)]
    return links + [lane for arm in grid.arm.values() for lane in _connectors(grid, arm)]


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
    return rounded(np.array([start, corner, end]), [radius_m])


def _links(grid: Grid, arm: Arm, groups: Groups) -> list[Draft]:
    """Lanes that leave a junction by `arm`, up to the next stop line."""
    far = grid.opposite(arm)
    num, avenue = arm.num_lanes, arm.num_lanes > 1
    exits = {(exit_.way, k, to) for exit_ in grid.arms(arm.far) for k, to in _pairs(far, exit_)}
    return [
        Draft(
            ("drive", arm.node, arm.way, k),
            lifted(straight(arm.at(STOP_M, -lane_offset_m(k)), far.at(STOP_M, lane_offset_m(k))), 0.0),
            "drive", LANE_M, _AVENUE_MPS if avenue else _STREET_MPS,
            tuple(("turn", far.node, far.way, k, way, to) for way, start, to in sorted(exits) if start == k),
            left=("drive", arm.node, arm.way, k - 1) if k else None,
            right=("drive", arm.node, arm.way, k + 1) if k + 1 < num else None,
            signal=groups[far.node, far.way],
            longest_m=AVENUE_LONGEST_M if avenue else np.inf,
        )
        for k in range(num)
    ]  # fmt: skip


def _pairs(approach: Arm, exit_: Arm) -> list[tuple[int, int]]:
    """Which lane of an approach leads to which of an exit: straight on keeps lanes, turns use the outermost."""
    turn = (exit_.way - approach.way) % 4
    straight_on = [(k, k) for k in range(approach.num_lanes)]
    return [[], [(approach.num_lanes - 1, exit_.num_lanes - 1)], straight_on, [(0, 0)]][turn]


def _connectors(grid: Grid, approach: Arm) -> list[Draft]:
    return [
        _connector(approach, exit_, k, to) for exit_ in grid.arms(approach.node) for k, to in _pairs(approach, exit_)
    ]


def _connector(approach: Arm, exit_: Arm, k: int, to: int) -> Draft:
    turn = (exit_.way - approach.way) % 4
    offsets = lane_offset_m(k), lane_offset_m(to)
    wide = min(approach.edge_m + offsets[1], exit_.edge_m + offsets[0]) + _ARC_END_M
    radius = CORNER_M + LANE_M / 2 if turn == 1 else wide
    speed = _AVENUE_MPS if approach.num_lanes > 1 else _STREET_MPS
    return Draft(
        ("turn", approach.node, approach.way, k, exit_.way, to),
        lifted(turn_path(approach, exit_, offsets, radius), 0.0), "drive", LANE_M,
        speed if turn == 2 else float(np.sqrt(_LATERAL_MPS2 * radius)),
        (("drive", exit_.node, exit_.way, to),), in_junction=True,
        longest_m=_longest_m(approach, exit_),
    )  # fmt: skip


def _longest_m(approach: Arm, exit_: Arm) -> float:
    if max(approach.num_lanes, exit_.num_lanes) > 1:
        return AVENUE_LONGEST_M
    left = (exit_.way - approach.way) % 4 == 3
    return BESIDE_BIKES_LONGEST_M if left and approach.has_bikes else np.inf


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
        Draft(("bike", *key), lifted(along, 0.0), "bike", BIKE_M, _BIKE_MPS, (onto,), signal=groups[key]),
        Draft(onto, lifted(turn, 0.0), "bike", BIKE_M, turn_mps, (("bike", before.node, before.way),),
              in_junction=True),
    ]  # fmt: skip
