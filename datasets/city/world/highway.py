"""The highway: a closed ring of two carriageways of three lanes, with all that stands beside it."""

import numpy as np

from fbench.datasets.city.world import city_map
from fbench.datasets.city.world.city_map import GROUND_Z_M, Draft, Kind, Layout, Parking, Patch, Placement, Polygon
from fbench.replay.conditions.generators import generator
from fbench.replay.data.arrays import Float64

Pair = tuple[float, float]
Three = tuple[float, float, float]
LANE_M, NUM_LANES = 3.5, 3
SPEEDS_MPS = (36.0, 32.0, 25.0)  # From left to right: about 130, 115 and 90 km/h
MEDIAN_M, INNER_SHOULDER_M, SHOULDER_M = 3.0, 1.0, 2.5
"""Widths of the whole median, and of the strips on the left and on the right of each carriageway's lanes."""
LEFT_EDGE_M = MEDIAN_M / 2 + INNER_SHOULDER_M
RIGHT_EDGE_M = LEFT_EDGE_M + NUM_LANES * LANE_M
PAVED_M = RIGHT_EDGE_M + SHOULDER_M
"""Where lanes begin and end, and where the asphalt ends, from the middle of the median."""
_STRAIGHT_M, RADIUS_M, _SEGMENT_M = 900.0, 500.0, 200.0
"""In the curves 36 m/s are a lateral acceleration of 2.6 m/s^2: nobody need brake for them."""
LENGTH_M = 2 * _STRAIGHT_M + 2 * np.pi * RADIUS_M  # Once around the middle of the median
NUM_SEGMENTS = round(LENGTH_M / _SEGMENT_M)


def ring_points(s_m: Float64, left_m: Float64 | float) -> Float64:
    """Points (N, 2) at distances (N,) along the middle of the median, counter-clockwise, and to its left."""
    s, half = np.asarray(s_m) % LENGTH_M, LENGTH_M / 2
    mirror = np.where(s >= half, -1.0, 1.0)  # the second half is the first, turned by 180 deg about the origin
    along = s % half
    angle = np.clip((along - _STRAIGHT_M) / RADIUS_M, 0, None)
    reach = RADIUS_M - left_m
    x = np.minimum(along, _STRAIGHT_M) - _STRAIGHT_M / 2 + reach * np.sin(angle)
    y = -reach * np.cos(angle)
    return mirror[:, None] * np.column_stack([x, np.broadcast_to(y, x.shape)])


def ring_heading(s_m: Float64) -> Float64:
    """Headings (N,) at distances (N,) along the middle of the median."""
    s, half = np.asarray(s_m) % LENGTH_M, LENGTH_M / 2
    return np.asarray(np.clip((s % half - _STRAIGHT_M) / RADIUS_M, 0, None) + np.where(s >= half, np.pi, 0.0))


def highway_lanes() -> list[Draft]:
    """All lanes: of the outer carriageway counter-clockwise, of the inner one clockwise."""
    step, drafts = LENGTH_M / NUM_SEGMENTS, []
    # Curves are longer outside: points are less than 1 m apart there too.
    num = int(np.ceil(step * (RADIUS_M + RIGHT_EDGE_M) / RADIUS_M)) + 1
    for way in (1, -1):
        for segment in range(NUM_SEGMENTS):
            s = (segment + np.linspace(0, 1, num)) * step * way
            for k in range(NUM_LANES):
                points = ring_points(s, -way * (LEFT_EDGE_M + (k + 0.5) * LANE_M))
                drafts.append(Draft(
                    (way, segment, k), city_map.lift(points, 0.0), "drive", LANE_M, SPEEDS_MPS[k],
                    ((way, (segment + 1) % NUM_SEGMENTS, k),),
                    left=(way, segment, k - 1) if k else None,
                    right=(way, segment, k + 1) if k + 1 < NUM_LANES else None,
                ))  # fmt: skip
    return drafts


BAY_M, BAY_WIDTH_M = 40.0, 1.8  # Emergency bays: the shoulder is wider there
_PAINT_Z_M = 0.005
_DASH_M, _PERIOD_M = 6.0, 18.0
_LINE_M, _WIDE_M = 0.15, 0.30
_BEND_M = 6.0  # Distance between corners of outlines: within 15 mm of the curve


def highway_ground(seed: int, bays_m: Float64) -> tuple[tuple[Polygon, ...], tuple[Patch, ...]]:
    """Both carriageways, each from the median to the end of its shoulder, segment by segment, with their bays; and
    their asphalt, the median and markings: edge lines all around, dashes between lanes. `bays_m` (B, 2) holds the bays'
    middles along the ring and their sides.
    """
    draw, half = generator(seed, "highway layout", "ground"), MEDIAN_M / 2
    roads = [_strip(*span, *edges) for span in _spans() for edges in ((-PAVED_M, -half), (half, PAVED_M))]
    bays = [_strip(s - BAY_M / 2, s + BAY_M / 2, *sorted((side * PAVED_M, side * (PAVED_M + BAY_WIDTH_M))))
            for s, side in bays_m]  # fmt: skip
    edges = ((LEFT_EDGE_M - _LINE_M, _LINE_M), (RIGHT_EDGE_M, _WIDE_M))
    lines = [_strip(*span, *sorted((side * edge, side * (edge + width))))
             for span in _spans() for side in (-1, 1) for edge, width in edges]  # fmt: skip
    num = round(LENGTH_M / _PERIOD_M)
    period = LENGTH_M / num
    between = [side * (LEFT_EDGE_M + k * LANE_M) for side in (-1, 1) for k in range(1, NUM_LANES)]
    lines += [_strip(k * period, k * period + _DASH_M, left - _LINE_M / 2, left + _LINE_M / 2)
              for left in between for k in range(num)]  # fmt: skip
    patches = (
        *(Patch("asphalt", outline, 0.0, shade=float(draw.uniform(0.85, 1.1))) for outline in roads),
        *(Patch("asphalt", outline, 0.0, shade=0.9) for outline in bays),
        *(Patch("grass", _strip(*span, -half, half), 0.0, shade=0.9) for span in _spans()),
        *(Patch("marking", outline, _PAINT_Z_M) for outline in lines),
    )
    return tuple(Polygon("road", outline) for outline in (*roads, *bays)), patches


def _spans() -> list[tuple[float, float]]:
    step = LENGTH_M / NUM_SEGMENTS
    return [(k * step, (k + 1) * step) for k in range(NUM_SEGMENTS)]


def _strip(from_m: float, to_m: float, right_m: float, left_m: float) -> Float64:
    """Outline (P, 2) along the ring between two offsets to its left."""
    s = np.linspace(from_m, to_m, int(np.ceil((to_m - from_m) / _BEND_M)) + 1)
    return np.concatenate([ring_points(s, right_m), ring_points(s[::-1], left_m)])


LAMP_REACH_M, LAMP_HEIGHT_M = 3.0, 11.0
BARRIER_M = 11.9  # Pieces of barrier: their chord is within 50 mm of the curve
_MEDIAN_BARRIER_M, _RAIL_M, _FENCE_M = 0.6, 0.7, 4.0  # From the median's middle; from the asphalt's end
_LIT_SHARE, _LAMP_SPACING_M = 0.3, 40.0


def highway_furniture(seed: int, bays_m: Float64) -> tuple[list[Placement], Float64]:
    """All that stands, and where the lamps shine from (L, 3): under the tips of the posts' arms. `bays_m` (B, 2) as in
    `highway_ground`.
    """
    start = float(generator(seed, "highway layout", "lamps").uniform(0, LENGTH_M))
    spots = [float(s) for s in np.arange(0, _LIT_SHARE * LENGTH_M, _LAMP_SPACING_M) + start]  # over one stretch
    size = (LAMP_REACH_M, 0.25, LAMP_HEIGHT_M)
    posts = [_stand("lamp_post", s, side * (PAVED_M + 1.3), -side * np.pi / 2, size)
             for s in spots for side in (-1, 1) if not _at_bay(s, side, bays_m)]  # fmt: skip
    foot, yaw = np.array([post.position_m for post in posts]), np.array([post.yaw_rad for post in posts])
    reach = LAMP_REACH_M * np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))])
    draw = generator(seed, "highway layout", "fences")
    fences = []
    for s in np.sort(draw.uniform(0, LENGTH_M - 250, 4)):
        end, side = float(s + draw.uniform(90, 220)), int(draw.choice([-1, 1]))
        fences += _chain("fence", float(s), end, side * (PAVED_M + BAY_WIDTH_M + _FENCE_M), (0.2, 3.5))
    standing = [*_barriers(bays_m), *_gantries_and_signs(seed, bays_m), *posts, *fences, *_plants(seed)]
    return standing, foot + reach + np.array([0.0, 0.0, LAMP_HEIGHT_M - 0.2])


def _barriers(bays_m: Float64) -> list[Placement]:
    """Two in the median, guard rails beside the shoulders; these step aside at the bays."""
    placements = []
    for left in (-_MEDIAN_BARRIER_M, _MEDIAN_BARRIER_M, -PAVED_M - _RAIL_M, PAVED_M + _RAIL_M):
        size = (0.3, 0.9) if abs(left) < MEDIAN_M else (0.25, 0.75)
        spans = [(0.0, LENGTH_M)]
        for s, side in bays_m:
            if abs(left) > MEDIAN_M and side * left > 0:
                a, b = s - BAY_M / 2, s + BAY_M / 2
                spans = [part for x, y in spans for part in ((x, min(y, a)), (max(x, b), y)) if part[1] > part[0]]
        for start, end in spans:
            placements += _chain("barrier", start, end, left, size)
    for s, side in bays_m:
        left = side * (PAVED_M + BAY_WIDTH_M + _RAIL_M)
        placements += _chain("barrier", s - BAY_M / 2, s + BAY_M / 2, left, (0.25, 0.75))
    return placements


def _chain(kind: Kind, from_m: float, to_m: float, left_m: float, width_height_m: Pair) -> list[Placement]:
    """Pieces end to end along the ring, each a chord."""
    num = int(np.ceil((to_m - from_m) * max(1.0, 1 - left_m / RADIUS_M) / BARRIER_M))
    ends = ring_points(np.linspace(from_m, to_m, num + 1), left_m)
    middle, way = (ends[:-1] + ends[1:]) / 2, np.diff(ends, axis=0)
    yaw, length = np.arctan2(way[:, 1], way[:, 0]), np.sqrt((way * way).sum(axis=1))
    return [
        Placement(kind, (float(x), float(y), GROUND_Z_M), float(a), (float(piece), *width_height_m), i)
        for i, ((x, y), a, piece) in enumerate(zip(middle, yaw, length, strict=True))
    ]


def _gantries_and_signs(seed: int, bays_m: Float64) -> list[Placement]:
    """Gantries over one carriageway each, some hundred meters apart, their feet between and behind the barriers; signs
    behind the guard rails. They look at the traffic of their side: counter-clockwise outside (-1), clockwise inside.
    """
    draw, width, placements = generator(seed, "highway layout", "gantries"), PAVED_M + 1.5, []
    for side in (-1, 1):
        turn = np.pi if side < 0 else 0.0
        for k in range(5):
            s, variant = (k + float(draw.uniform(0.2, 0.8))) * LENGTH_M / 5, int(draw.integers(1 << 30))
            if not _at_bay(s, side, bays_m):
                placements.append(_stand("gantry", s, side * width / 2, turn, (0.6, width, 7.2), variant))
    draw = generator(seed, "highway layout", "signs")
    for side in (-1, 1):
        left, turn = side * (PAVED_M + BAY_WIDTH_M + 1.6), np.pi if side < 0 else 0.0
        for _ in range(14):
            s, variant = float(draw.uniform(0, LENGTH_M)), int(draw.integers(1 << 30))
            placements.append(_stand("sign", s, left, turn, (0.1, 0.9, 2.8), variant))
    return placements


def _at_bay(s_m: float, side: int, bays_m: Float64) -> bool:
    away = np.abs((bays_m[:, 0] - s_m + LENGTH_M / 2) % LENGTH_M - LENGTH_M / 2)
    return bool(np.any((away < BAY_M / 2 + 2) & (bays_m[:, 1] == side)))


def _place(s_m: float, left_m: float) -> Three:
    x, y = ring_points(np.array([s_m]), left_m)[0]
    return float(x), float(y), GROUND_Z_M


def _stand(kind: Kind, s_m: float, left_m: float, turn_rad: float, size: Three, variant: int = 0) -> Placement:
    yaw = float(ring_heading(np.array([s_m]))[0]) + turn_rad
    return Placement(kind, _place(s_m, left_m), float(yaw % (2 * np.pi)), size, variant)


def _plants(seed: int) -> list[Placement]:
    """Trees and bushes on both sides; clear of fences, signs and lamp posts."""
    draw, plants = generator(seed, "highway layout", "plants"), []
    spots = [(float(s + draw.uniform(-5, 5)), side) for s in np.arange(0, LENGTH_M, 14.0) for side in (-1, 1)]
    for s, side in spots:
        if draw.random() < 0.75:
            position = _place(s, side * (PAVED_M + float(draw.uniform(10, 40 if draw.random() < 0.6 else 16))))
            yaw, variant = float(draw.uniform(0, 2 * np.pi)), int(draw.integers(1 << 30))
            wide, kind = float(draw.uniform(0, 1)), "bush" if draw.random() < 0.35 else "tree"
            if kind == "bush":
                plants.append(Placement("bush", position, yaw, (1.2 + wide, 1.2 + wide, 1.0 + wide), variant))
            else:
                plants.append(Placement("tree", position, yaw, (4 + 3 * wide, 4 + 3 * wide, 8 + 6 * wide), variant))
    return plants


_BAYS = 4  # Emergency bays of each carriageway
_STANDING_M = 14.0  # Length of a place in a bay: even a bus may have broken down


def highway_layout(seed: int) -> Layout:
    """Lay out the ring: two straights of 0.9 km and two half circles."""
    no_signals = city_map.SignalPlan(60.0, np.zeros(0), np.zeros(0))
    draw, spacing = generator(seed, "highway layout", "bays"), LENGTH_M / _BAYS
    bays_m = np.array([[(k + float(draw.uniform(0.1, 0.9))) * spacing, side] for side in (-1, 1) for k in range(_BAYS)])
    yaws = ring_heading(bays_m[:, 0]) + np.where(bays_m[:, 1] > 0, np.pi, 0.0)
    places = []
    for (s, side), yaw in zip(bays_m, yaws, strict=True):
        x, y, _ = _place(s, side * (PAVED_M + BAY_WIDTH_M / 2 - 0.6))
        places.append(Parking((x, y, 0.0), float(yaw % (2 * np.pi)), _STANDING_M))
    regions, patches = highway_ground(seed, bays_m)
    standing, lamps_m = highway_furniture(seed, bays_m)
    lanes = city_map.join_points(highway_lanes())
    plan = city_map.CityMap("highway", lanes, no_signals, regions, tuple(places), lamps_m)
    return Layout(plan, patches, tuple(standing))
