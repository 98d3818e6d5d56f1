"""Blocks of houses: rows along the streets around a yard, or a park."""

from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.world.layout import Placement
from fbench.datasets.city.world.street_grid import SIDEWALK_M, Arm, Cell, Grid
from fbench.datasets.city.world.urban_walks import SIDEWALK_Z_M
from fbench.replay.draws import generator

_CORNER_M = 1.2
"""Houses at corners stand back from both streets, so that they don't reach into the sidewalk's bend."""
_PARK_SHARE, _GAP_SHARE = 0.2, 0.25
_WIDTH_M, _DEPTH_M, _HEIGHT_M = (9.0, 24.0), (9.0, 14.0), (6.0, 25.0)


@dataclass(frozen=True)
class _Front:
    """Where one row of houses stands: along the left side of an arm."""

    arm: Arm
    from_m: float
    to_m: float
    """Along the arm."""
    depth_m: float


def block_placements(seed: int, grid: Grid) -> list[Placement]:
    """Houses, parks and yards of all blocks, and houses around the world."""
    placements: list[Placement] = []
    for cell, ring in zip(grid.cells, grid.rings, strict=False):
        draw = generator(seed, "urban layout", "block", *cell)
        fronts = _fronts(draw, grid, ring)
        if is_park(seed, cell):
            placements += _green(draw, ring, grid, 0.0, 40)
        else:
            tall = float(draw.uniform(8, 22))
            placements += [house for front in fronts for house in _row(draw, front, tall)]
            placements += _green(draw, ring, grid, max(front.depth_m for front in fronts) + 4.0, 8)
    return placements + _around_the_world(seed, grid)


def is_park(seed: int, cell: Cell) -> bool:
    """Whether a block has trees instead of houses."""
    return bool(generator(seed, "urban layout", "park", *cell).random() < _PARK_SHARE)


def _fronts(draw: np.random.Generator, grid: Grid, ring: list[Arm]) -> list[_Front]:
    """Two rows from end to end of a block and two between them."""
    depths = [float(draw.uniform(*_DEPTH_M)) for _ in ring]
    fronts = []
    for k, arm in enumerate(ring):
        before, after, far = ring[k - 1], ring[(k + 1) % 4], grid.opposite(arm)
        start, end = before.left_extra_m + SIDEWALK_M, arm.length_to(far) - after.left_extra_m - SIDEWALK_M
        if k % 2:  # between the rows beside it, with a passage of 3 m and room for their setback
            start, end = start + depths[k - 1] + 4.5, end - depths[(k + 1) % 4] - 4.5
        else:
            start, end = start + _CORNER_M, end - _CORNER_M
        fronts.append(_Front(arm, start, end, depths[k]))
    return fronts


def _row(draw: np.random.Generator, front: _Front, tall_m: float) -> list[Placement]:
    """Houses side by side, some with a gap between them."""
    row, at = [], front.from_m
    while front.to_m - at >= _WIDTH_M[0]:
        width = float(min(draw.uniform(*_WIDTH_M), front.to_m - at))
        if front.to_m - at - width < _WIDTH_M[0]:
            width = min(front.to_m - at, _WIDTH_M[1] + 5)
        height = float(np.clip(tall_m + draw.uniform(-4, 4), *_HEIGHT_M))
        setback = _CORNER_M + float(draw.choice([0.0, 0.0, 0.3]))
        depth = front.depth_m - float(draw.uniform(0, 2))
        row.append(_house(draw, front.arm, at + width / 2, setback, (depth, width, height)))
        at += width + (float(draw.uniform(2, 7)) if draw.random() < _GAP_SHARE else 0.02)
    return row


def _house(draw: np.random.Generator, arm: Arm, along: float, setback: float,
           size: tuple[float, float, float]) -> Placement:  # fmt: skip
    x, y = arm.at(along, arm.left_kerb_m + SIDEWALK_M + setback + size[0] / 2)
    yaw = (arm.yaw_rad - np.pi / 2) % (2 * np.pi)
    return Placement("building", (float(x), float(y), SIDEWALK_Z_M), float(yaw), size, int(draw.integers(1 << 30)))


def _green(draw: np.random.Generator, ring: list[Arm], grid: Grid, inset_m: float, num: int) -> list[Placement]:
    """Trees and bushes at least `inset_m` within a block's sidewalks, no two within 4 m."""
    arm, after = ring[0], ring[1]
    margin = SIDEWALK_M + inset_m + 2.5
    corner = arm.at(ring[-1].left_extra_m + margin, arm.left_kerb_m + margin)
    opposite = grid.opposite(after).at(ring[2].left_extra_m + margin, -after.left_kerb_m - margin)
    if (opposite - corner).min() < 2:
        return []
    chosen: list[Placement] = []
    for spot in draw.uniform(corner, opposite, (num, 2)):
        if all(np.hypot(spot[0] - p.position_m[0], spot[1] - p.position_m[1]) > 4 for p in chosen):
            chosen.append(plant(draw, float(spot[0]), float(spot[1]), SIDEWALK_Z_M))
    return chosen


def plant(draw: np.random.Generator, x: float, y: float, z: float) -> Placement:
    """A tree, or sometimes a bush."""
    position, yaw, variant = (x, y, z), float(draw.uniform(0, 2 * np.pi)), int(draw.integers(1 << 30))
    if draw.random() < 0.25:
        wide = float(draw.uniform(0.8, 1.8))
        return Placement("bush", position, yaw, (wide, wide, wide * 0.8), variant)
    wide = float(draw.uniform(3, 4.5))
    return Placement("tree", position, yaw, (wide, wide, float(wide * draw.uniform(1.6, 2.2))), variant)


def _around_the_world(seed: int, grid: Grid) -> list[Placement]:
    """Rows of houses outside of the border streets; a tree where a street ends."""
    placements = []
    for k, arm in enumerate(grid.rings[-1]):
        draw = generator(seed, "urban layout", "outside", k)
        front = _Front(arm, 0.0, arm.length_to(grid.opposite(arm)), float(draw.uniform(*_DEPTH_M)))
        placements += _row(draw, front, float(draw.uniform(8, 20)))
        x, y = arm.at(-arm.edge_m, arm.left_kerb_m + SIDEWALK_M + 6.0)
        placements.append(plant(draw, float(x), float(y), SIDEWALK_Z_M))
    return placements
