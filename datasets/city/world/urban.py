"""The urban world with all that stands on its sidewalks, and the worlds by name.

signals, signs, trees, benches, bins, hydrants.

A junction, outwards from the crossing street's drive lanes: kerbs bend up to 6.5 m, people cross from 7.2 to 10.8 m,
vehicles wait at 12.5 m. Approaches that face each other are green together, then the others, then all crossings: see
`urban_signals`. Right turns of cars and bicycles are arcs about one centre, bicycles inside; left turns are as wide as
fits, 12.4 m and more.
"""

from typing import Literal, TypeAlias

import numpy as np

from fbench.datasets.city.spec import WorldName
from fbench.datasets.city.world.city_map import CityMap, Kind, Layout, Placement, joined
from fbench.datasets.city.world.highway import highway_layout
from fbench.datasets.city.world.street_grid import PARKING_M, Arm, Grid, drawn_grid
from fbench.datasets.city.world.urban_ground import block_placements, ground_patches, marking_patches, regions
from fbench.datasets.city.world.urban_lanes import (
    CROSSING_M,
    SIDEWALK_Z_M,
    bike_lanes,
    drive_lanes,
    parkings,
    walk_lanes,
)
from fbench.datasets.city.world.urban_signals import Groups, signal_groups, signal_plan
from fbench.replay.conditions.generators import generator
from fbench.replay.data.arrays import Float64

LAMP_REACH_M, LAMP_HEIGHT_M = 2.2, 8.0
_KERB_M = 0.4
_LAMP_SPACING_M, _TREE_SPACING_M = 27.0, 9.0
_SIGNAL_M, _FROM_M = 12.0, 16.0
"""Along an arm: signals, and where other things begin."""

Facing: TypeAlias = Literal["out", "road", "house"]
Size: TypeAlias = tuple[float, float, float]


def furniture(seed: int, grid: Grid, groups: Groups) -> list[Placement]:
    """All that stands on the sidewalks."""
    placements = []
    for arm in grid.arm.values():
        draw = generator(seed, "urban layout", "furniture", *arm.node, arm.way)
        placements += (
            _signals(grid, arm, groups) + _lamps(grid, arm) + _rest(draw, arm, arm.length_to(grid.opposite(arm)))
        )
    return placements


def street_lamps_m(grid: Grid) -> Float64:
    """Where the lamps shine from (L, 3): under the tips of the posts' arms."""
    lamps = []
    for arm in grid.arm.values():
        for post in _lamps(grid, arm):
            x, y, _ = post.position_m
            lamps.append([x + LAMP_REACH_M * np.cos(post.yaw_rad), y + LAMP_REACH_M * np.sin(post.yaw_rad),
                          SIDEWALK_Z_M + LAMP_HEIGHT_M - 0.2])  # fmt: skip
    return np.array(lamps)


def _signals(grid: Grid, arm: Arm, groups: Groups) -> list[Placement]:
    """At the stop line, beyond the junction, and for those who cross at both kerbs."""
    group, walk = groups.approaches[arm.node, arm.way], groups.walks[arm.node]
    near = _at_kerb(arm, "signal", _SIGNAL_M, (0.3, 0.3, 3.4), "out", signal=group)
    ahead = grid.arm.get((arm.node, (arm.way + 2) % 4))
    beyond = []
    if ahead is not None:
        x, y = ahead.at(CROSSING_M[0] - 0.2, -ahead.right_kerb_m - _KERB_M)
        beyond = [Placement("signal", (float(x), float(y), SIDEWALK_Z_M), arm.yaw_rad, (0.3, 0.3, 3.4), signal=group)]
    walks = []
    for side, left in ((1, arm.left_kerb_m + _KERB_M), (-1, -arm.right_kerb_m - _KERB_M)):
        x, y = arm.at(CROSSING_M[1] + 0.15, left)
        yaw = float((arm.yaw_rad - side * np.pi / 2) % (2 * np.pi))
        walks.append(Placement("signal", (float(x), float(y), SIDEWALK_Z_M), yaw, (0.25, 0.25, 2.6), signal=walk))
    return [near, *beyond, *walks]


def _lamps(grid: Grid, arm: Arm) -> list[Placement]:
    """On one side of streets, on both of avenues."""
    if arm.way > 1 and arm.num_lanes == 1:
        return []
    spots = _spots(arm.length_to(grid.opposite(arm)), _LAMP_SPACING_M)
    return [_at_kerb(arm, "lamp_post", s, (LAMP_REACH_M, 0.2, LAMP_HEIGHT_M), "road") for s in spots]


def _spots(length_m: float, spacing_m: float) -> list[float]:
    """Evenly along a side, clear of the junctions."""
    num = max(1, round((length_m - 2 * _FROM_M) / spacing_m) + 1)
    return [float(s) for s in np.linspace(_FROM_M, length_m - _FROM_M, num)]


def _rest(draw: np.random.Generator, arm: Arm, length_m: float) -> list[Placement]:
    """A sign, and things between the lamp posts' places."""
    placements = [_at_kerb(arm, "sign", length_m - _FROM_M + 1.5, (0.1, 0.6, 2.6), "out", int(draw.integers(1 << 30)))]
    for s in _spots(length_m, _TREE_SPACING_M):
        spot = s + 3.0 + float(draw.uniform(-0.7, 0.7))
        thing = _thing(draw, arm, spot)
        if thing is not None and spot < length_m - _FROM_M - 1:
            placements.append(thing)
    return placements


def _thing(draw: np.random.Generator, arm: Arm, along_m: float) -> Placement | None:
    """Most are trees, where their crowns don't reach the drive lanes."""
    chosen, variant = float(draw.random()), int(draw.integers(1 << 30))
    wide, high = float(draw.uniform(2.6, 3.8)), float(draw.uniform(6, 8.5))
    if chosen < 0.62:
        has_room = arm.left_extra_m >= PARKING_M
        return _at_kerb(arm, "tree", along_m, (wide, wide, high), "road", variant) if has_room else None
    if chosen < 0.70:
        return _at_kerb(arm, "bench", along_m, (0.45, 1.6, 0.85), "house", variant)
    if chosen < 0.80:
        return _at_kerb(arm, "bin", along_m, (0.4, 0.4, 0.9), "house", variant)
    return _at_kerb(arm, "hydrant", along_m, (0.3, 0.3, 0.8), "road", variant) if chosen < 0.85 else None


def _at_kerb(
    arm: Arm, kind: Kind, along_m: float, size_lwh_m: Size, facing: Facing, variant: int = 0, signal: int | None = None
) -> Placement:
    """Something beside the kerb on the left of an arm."""
    x, y = arm.at(along_m, arm.left_kerb_m + _KERB_M)
    turn = {"out": 0.0, "road": -np.pi / 2, "house": np.pi / 2}[facing]
    yaw = float((arm.yaw_rad + turn) % (2 * np.pi))
    return Placement(kind, (float(x), float(y), SIDEWALK_Z_M), yaw, size_lwh_m, variant, signal)


def urban_layout(seed: int) -> Layout:
    """Lay out a world of 4 x 4 junctions, about 400 m wide."""
    grid = drawn_grid(seed)
    groups = signal_groups(grid)
    drafts = [
        *drive_lanes(grid, groups.approaches),
        *bike_lanes(grid, groups.approaches),
        *walk_lanes(grid, groups.walks),
    ]
    signals = signal_plan(seed, grid, groups, drafts)
    city_map = CityMap("urban", joined(drafts), signals, regions(grid), parkings(grid), street_lamps_m(grid))
    patches = (*ground_patches(seed, grid), *marking_patches(grid))
    return Layout(city_map, patches, (*block_placements(seed, grid), *furniture(seed, grid, groups)))


def layout(world: WorldName, seed: int) -> Layout:
    """Lay out a world; the same for the same seed, another for another."""
    return urban_layout(seed) if world == "urban" else highway_layout(seed)
