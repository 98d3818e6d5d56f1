"""Ground of the urban world: streets, junctions, markings and blocks of houses.

They touch and don't overlap: streets lie between junctions, sidewalks follow one side of a street and the bend after
it, and what they enclose is the block.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.world import urban_lanes
from fbench.datasets.city.world.city_map import Patch, Placement, Polygon, round_corners, sparse
from fbench.datasets.city.world.street_grid import BIKE_M, CORNER_M, LANE_M, PARKING_M, SIDEWALK_M, STOP_M, Arm, Grid
from fbench.datasets.city.world.urban_lanes import CROSSING_M, OUTER_CORNER_M, SIDEWALK_Z_M
from fbench.replay.conditions.generators import generator
from fbench.replay.data.arrays import Float64

PAINT_Z_M, ARROW_Z_M = 0.005, 0.008
_LINE_M, _THIN_M = 0.15, 0.10
_DASH_M, _GAP_M = 3.0, 4.0
_STOP_LINE_M = (11.8, 12.2)  # Along an arm, just beyond the lanes' ends


def marking_patches(grid: Grid) -> list[Patch]:
    """Markings of all streets."""
    center, sides, ends, arrows = list[Float64](), list[Float64](), list[Float64](), list[Float64]()
    for arm in grid.arm.values():
        far, avenue = grid.opposite(arm), arm.num_lanes > 1
        end, half = arm.length_to(far) - STOP_M, _THIN_M / 2
        if arm.way < 2 and avenue:
            center += [_bar(arm, (STOP_M, end), (o - half, o + half)) for o in (-0.12, 0.12)]
        elif arm.way < 2:
            center += _dashes(arm, end, 0.0)
        # On its left: lane lines, the edge of the drive lanes, and parking spaces.
        for k in range(1, arm.num_lanes):
            sides += _dashes(arm, end, k * LANE_M)
        sides.append(_bar(arm, (STOP_M, end), (arm.half_m - _LINE_M / 2, arm.half_m + _LINE_M / 2)))
        parking, spaces = arm.left_kerb_m - PARKING_M, urban_lanes.spaces_m(arm, far)
        if spaces and arm.left_extra_m > PARKING_M:
            sides.append(_bar(arm, (STOP_M, end), (parking - _THIN_M, parking)))
        across = (parking + 0.1, parking + PARKING_M - 0.05)
        sides += [_bar(arm, (s - half, s + half), across) for s in sorted({s for space in spaces for s in space})]
        # A crossing of bars of 0.5 m across the whole street, and stop lines.
        num, middle = int(arm.left_kerb_m + arm.right_kerb_m - 0.3), (arm.left_kerb_m - arm.right_kerb_m) / 2
        bars = [middle + k - (num - 1) / 2 for k in range(num)]
        ends += [_bar(arm, CROSSING_M, (o - 0.25, o + 0.25)) for o in bars]
        ends.append(_bar(arm, _STOP_LINE_M, (0.2, arm.half_m - 0.2)))
        if arm.has_bikes:
            ends.append(_bar(arm, _STOP_LINE_M, (arm.half_m + 0.2, arm.half_m + BIKE_M - 0.2)))
        arrows += _arrows(grid, arm) if avenue else []
    return [
        *(Patch("marking", outline, PAINT_Z_M) for outline in (*center, *sides, *ends)),
        *(Patch("marking", outline, ARROW_Z_M) for outline in arrows),
    ]


def _dashes(arm: Arm, end_m: float, left_m: float) -> Iterator[Float64]:
    for start in np.arange(STOP_M, end_m - _DASH_M, _DASH_M + _GAP_M):
        yield _bar(arm, (float(start), float(start) + _DASH_M), (left_m - _THIN_M / 2, left_m + _THIN_M / 2))


def _arrows(grid: Grid, arm: Arm) -> Iterator[Float64]:
    """On avenues: straight on from each lane that goes there, with a branch for the turn that it also allows."""
    ways = {(exit_.way - arm.way) % 4 for exit_ in grid.arms(arm.node)}
    for k in range(arm.num_lanes):
        o = urban_lanes.lane_offset_m(k)
        turn, side = (3, -1.0) if k == 0 else (1, 1.0)  # seen outwards, the driver's left is on our right
        yield _polygon(arm, o, [(17.0, -0.1), (21.0, -0.1), (21.0, 0.1), (17.0, 0.1)])
        if 2 in ways:
            yield _polygon(arm, o, [(15.6, 0.0), (17.0, -0.4), (17.0, 0.4)])
        if turn in ways:
            tip = [(18.2, side * 1.0), (17.7, side * 0.45), (18.7, side * 0.45)]
            stem = [(18.05, side * 0.1), (18.05, side * 0.45), (18.35, side * 0.45), (18.35, side * 0.1)]
            yield from (_polygon(arm, o, shape) for shape in (tip, stem))


def _polygon(arm: Arm, left_m: float, shape: list[tuple[float, float]]) -> Float64:
    """An outline from (along, left) pairs, counter-clockwise whichever way they are given."""
    points = np.array([arm.at(along, left_m + left) for along, left in shape])
    x, y = points.T
    area = (x * np.roll(y, -1) - np.roll(x, -1) * y).sum()
    return points if area > 0 else points[::-1].copy()


def _bar(arm: Arm, along_m: tuple[float, float], left_m: tuple[float, float]) -> Float64:
    (a, b), (right, left) = along_m, left_m
    return np.array([arm.at(a, right), arm.at(b, right), arm.at(b, left), arm.at(a, left)])


_CORNER_M = 1.2  # Houses at corners stand back from both streets, so that they don't reach into the sidewalk's bend
_PARK_SHARE, _GAP_SHARE = 0.2, 0.25
_WIDTH_M, _DEPTH_M, _HEIGHT_M = (9.0, 24.0), (9.0, 14.0), (6.0, 25.0)


@dataclass(frozen=True)
class _Front:
    """Where one row of houses stands: along the left side of an arm."""

    arm: Arm
    from_m: float
    to_m: float  # Along the arm
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
    for k, arm in enumerate(grid.rings[-1]):  # rows of houses outside of the border streets; trees where streets end
        draw = generator(seed, "urban layout", "outside", k)
        front = _Front(arm, 0.0, arm.length_to(grid.opposite(arm)), float(draw.uniform(*_DEPTH_M)))
        placements += _row(draw, front, float(draw.uniform(8, 20)))
        placements.append(plant(draw, *arm.at(-arm.edge_m, arm.left_kerb_m + SIDEWALK_M + 6.0).tolist()))
    return placements


def is_park(seed: int, cell: tuple[int, int]) -> bool:
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
    row, arm, at = [], front.arm, front.from_m
    while front.to_m - at >= _WIDTH_M[0]:
        width = float(min(draw.uniform(*_WIDTH_M), front.to_m - at))
        if front.to_m - at - width < _WIDTH_M[0]:
            width = min(front.to_m - at, _WIDTH_M[1] + 5)
        height = float(np.clip(tall_m + draw.uniform(-4, 4), *_HEIGHT_M))
        setback = _CORNER_M + float(draw.choice([0.0, 0.0, 0.3]))
        depth = front.depth_m - float(draw.uniform(0, 2))
        x, y = arm.at(at + width / 2, arm.left_kerb_m + SIDEWALK_M + setback + depth / 2)
        yaw, variant = float((arm.yaw_rad - np.pi / 2) % (2 * np.pi)), int(draw.integers(1 << 30))
        position = (float(x), float(y), SIDEWALK_Z_M)
        row.append(Placement("building", position, yaw, (depth, width, height), variant))
        at += width + (float(draw.uniform(2, 7)) if draw.random() < _GAP_SHARE else 0.02)
    return row


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
            chosen.append(plant(draw, *spot.tolist()))
    return chosen


def plant(draw: np.random.Generator, x: float, y: float) -> Placement:
    """A tree, or sometimes a bush."""
    position, yaw, variant = (x, y, SIDEWALK_Z_M), float(draw.uniform(0, 2 * np.pi)), int(draw.integers(1 << 30))
    if draw.random() < 0.25:
        wide = float(draw.uniform(0.8, 1.8))
        return Placement("bush", position, yaw, (wide, wide, wide * 0.8), variant)
    wide = float(draw.uniform(3, 4.5))
    return Placement("tree", position, yaw, (wide, wide, float(wide * draw.uniform(1.6, 2.2))), variant)


OUTSKIRTS_M = 45.0  # How far the ground of the blocks goes on around the world, from the outer sidewalk
_YARDS = ("grass", "soil", "concrete")
_CUT_M = CROSSING_M[0]  # Along an arm, all kerbs and sidewalks are straight from here on


def urban_ground(seed: int, grid: Grid) -> tuple[tuple[Polygon, ...], list[Patch]]:
    """Roads and sidewalks; and patches of their asphalt and pavement, of what lies inside the blocks, and of the ground
    around the world: a frame in as many pieces as outer sidewalks.
    """
    draw = generator(seed, "urban layout", "ground")
    streets = []  # from kerb to kerb, between junctions
    for arm in grid.arm.values():
        if arm.way < 2:
            far, left, right = grid.opposite(arm), arm.left_kerb_m, arm.right_kerb_m
            corners = ((arm, -right), (far, right), (far, -left), (arm, left))
            streets.append(np.array([end.at(CORNER_M, offset) for end, offset in corners]))
    junctions = [_junction(grid.arms(node)) for node in grid.nodes]
    walks = [np.concatenate([_kerb_line(ring, k, 0.0), _kerb_line(ring, k, SIDEWALK_M)[::-1]])
             for ring in grid.rings for k in range(len(ring))]  # fmt: skip
    patches = [Patch("asphalt", outline, 0.0, shade=float(draw.uniform(0.85, 1.1))) for outline in streets]
    patches += [Patch("asphalt", outline, 0.0, shade=0.95) for outline in junctions]
    patches += [Patch("sidewalk", outline, SIDEWALK_Z_M, has_kerb=True) for outline in walks]
    for cell, ring in zip(grid.cells, grid.rings, strict=False):
        inside = np.concatenate([_kerb_line(ring, k, SIDEWALK_M) for k in range(len(ring))])
        patches.append(Patch("grass" if is_park(seed, cell) else str(draw.choice(_YARDS)), inside, SIDEWALK_Z_M))
    ring, reach = grid.rings[-1], SIDEWALK_M + OUTSKIRTS_M
    for k, arm in enumerate(ring):
        after = ring[(k + 1) % len(ring)]
        outside = [after.at(_CUT_M, after.left_kerb_m + reach), arm.at(_CUT_M, arm.left_kerb_m + reach)]
        if after.way != arm.way:
            outside.insert(1, urban_lanes.kerb_corner(arm, after, reach)[0])
        outline = np.concatenate([_kerb_line(ring, k, SIDEWALK_M), outside])
        patches.append(Patch("grass", outline, SIDEWALK_Z_M, has_kerb=True))
    roads = [Polygon("road", outline) for outline in (*streets, *junctions)]
    return (*roads, *(Polygon("sidewalk", outline) for outline in walks)), patches


def _junction(arms: list[Arm]) -> Float64:
    """Kerbs of a junction (P, 2), up to where its streets begin."""
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
        pieces.append(sparse(round_corners(np.array([start, corner, end]), [radius])))
    return np.concatenate(pieces)


def _kerb_line(ring: list[Arm], k: int, inset_m: float) -> Float64:
    arm, after = ring[k], ring[(k + 1) % len(ring)]
    start, end = (one.at(_CUT_M, one.left_kerb_m + inset_m) for one in (arm, after))
    line = urban_lanes.follow_kerb(arm, after, inset_m, start, end)
    return line[[0, -1]] if arm.way == after.way else sparse(line)
