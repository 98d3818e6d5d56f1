"""The urban world's ground: outlines of streets, junctions, sidewalks and blocks, as patches and as regions.

They touch and don't overlap: streets lie between junctions, sidewalks follow one side of a street and the bend after
it, and what they enclose is the block.
"""

import numpy as np

from fbench.datasets.city.world.buildings import is_park
from fbench.datasets.city.world.city_map import Polygon
from fbench.datasets.city.world.lane_paths import rounded, sparse, straight
from fbench.datasets.city.world.layout import Patch
from fbench.datasets.city.world.street_grid import CORNER_M, SIDEWALK_M, Arm, Grid, Node
from fbench.datasets.city.world.urban_walks import CROSSING_M, OUTER_CORNER_M, SIDEWALK_Z_M, kerb_corner
from fbench.replay.arrays import Float64
from fbench.replay.draws import generator

OUTSKIRTS_M = 45.0
"""How far the ground of the blocks goes on around the world, from the outer sidewalk."""
_YARDS = ("grass", "soil", "concrete")
_CUT_M = CROSSING_M[0]
"""Along an arm, all kerbs and sidewalks are straight from here on."""


def regions(grid: Grid) -> tuple[Polygon, ...]:
    """Roads and sidewalks."""
    roads = [*street_outlines(grid), *(junction_outline(grid, node) for node in grid.nodes)]
    return (
        *(Polygon("road", outline) for outline in roads),
        *(Polygon("sidewalk", outline) for outline in sidewalk_outlines(grid)),
    )


def ground_patches(seed: int, grid: Grid) -> list[Patch]:
    """Asphalt, sidewalks and what lies inside the blocks."""
    draw = generator(seed, "urban layout", "ground")
    streets = [Patch("asphalt", o, 0.0, shade=float(draw.uniform(0.85, 1.1))) for o in street_outlines(grid)]
    junctions = [Patch("asphalt", junction_outline(grid, node), 0.0, shade=0.95) for node in grid.nodes]
    walks = [Patch("sidewalk", o, SIDEWALK_Z_M, has_kerb=True) for o in sidewalk_outlines(grid)]
    inner = [
        Patch("grass" if is_park(seed, cell) else str(draw.choice(_YARDS)), block_outline(ring), SIDEWALK_Z_M)
        for cell, ring in zip(grid.cells, grid.rings, strict=False)
    ]
    return [*streets, *junctions, *walks, *inner, *_outskirts(grid)]


def street_outlines(grid: Grid) -> list[Float64]:
    """Rectangles (4, 2) between junctions, from kerb to kerb."""
    outlines = []
    for arm in grid.arm.values():
        if arm.way < 2:
            far, left, right = grid.opposite(arm), arm.left_kerb_m, arm.right_kerb_m
            corners = [
                arm.at(CORNER_M, -right),
                far.at(CORNER_M, right),
                far.at(CORNER_M, -left),
                arm.at(CORNER_M, left),
            ]
            outlines.append(np.array(corners))
    return outlines


def junction_outline(grid: Grid, node: Node) -> Float64:
    """Kerbs of a junction (P, 2), up to where its streets begin."""
    arms = grid.arms(node)
    pieces = []
    for arm, after in zip(arms, [*arms[1:], arms[0]], strict=True):
        left, right = arm.left_kerb_m, after.right_kerb_m
        start, end = arm.at(CORNER_M, left), after.at(CORNER_M, -right)
        if (after.way - arm.way) % 4 == 2:
            pieces.append(np.array([start, end]))
            continue
        corner = arm.origin_m + left * arm.left - right * after.left
        inner = (after.way - arm.way) % 4 == 1
        radius = CORNER_M - max(arm.left_extra_m, after.right_extra_m) if inner else OUTER_CORNER_M
        pieces.append(sparse(rounded(np.array([start, corner, end]), [radius])))
    return np.concatenate(pieces)


def sidewalk_outlines(grid: Grid) -> list[Float64]:
    """Strips (P, 2), each along one arm and around the bend after it."""
    return [
        np.concatenate([_kerb_line(ring, k, 0.0), _kerb_line(ring, k, SIDEWALK_M)[::-1]])
        for ring in grid.rings
        for k in range(len(ring))
    ]


def block_outline(ring: list[Arm]) -> Float64:
    """What the sidewalks of a block enclose (P, 2)."""
    return np.concatenate([_kerb_line(ring, k, SIDEWALK_M) for k in range(len(ring))])


def _kerb_line(ring: list[Arm], k: int, inset_m: float) -> Float64:
    arm, after = ring[k], ring[(k + 1) % len(ring)]
    start = arm.at(_CUT_M, arm.left_kerb_m + inset_m)
    end = after.at(_CUT_M, after.left_kerb_m + inset_m)
    if arm.way == after.way:
        return straight(start, end)[[0, -1]]
    corner, radius = kerb_corner(arm, after, inset_m)
    return sparse(rounded(np.array([start, corner, end]), [radius]))


def _outskirts(grid: Grid) -> list[Patch]:
    """Ground outside of the outer sidewalks: a frame in as many pieces as sidewalks."""
    ring = grid.rings[-1]
    patches = []
    for k in range(len(ring)):
        arm, after, inside = ring[k], ring[(k + 1) % len(ring)], _kerb_line(ring, k, SIDEWALK_M)
        reach = SIDEWALK_M + OUTSKIRTS_M
        outside = [after.at(_CUT_M, after.left_kerb_m + reach)]
        if after.way != arm.way:
            outside.append(kerb_corner(arm, after, reach)[0])
        outside.append(arm.at(_CUT_M, arm.left_kerb_m + reach))
        patches.append(Patch("grass", np.concatenate([inside, outside]), SIDEWALK_Z_M, has_kerb=True))
    return patches
