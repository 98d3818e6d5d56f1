"""Lanes and ground of the highway: two carriageways of three lanes, median and markings."""

import numpy as np

from fbench.datasets.city.world.city_map import Draft, Patch, Polygon, lifted
from fbench.replay.conditions.generators import generator
from fbench.replay.data.arrays import Float64

LANE_M, NUM_LANES = 3.5, 3
SPEEDS_MPS = (36.0, 32.0, 25.0)
"""From left to right: about 130, 115 and 90 km/h."""
MEDIAN_M, INNER_SHOULDER_M, SHOULDER_M = 3.0, 1.0, 2.5
"""Widths of the whole median, and of the strips on the left and on the right of each carriageway's lanes."""
LEFT_EDGE_M = MEDIAN_M / 2 + INNER_SHOULDER_M
RIGHT_EDGE_M = LEFT_EDGE_M + NUM_LANES * LANE_M
PAVED_M = RIGHT_EDGE_M + SHOULDER_M
"""Where lanes begin and end, and where the asphalt ends, from the middle of the median."""
_STRAIGHT_M, RADIUS_M, _SEGMENT_M = 900.0, 500.0, 200.0
"""In the curves 36 m/s are a lateral acceleration of 2.6 m/s^2: nobody need brake for them."""


LENGTH_M = 2 * _STRAIGHT_M + 2 * np.pi * RADIUS_M
"""Once around the middle of the median."""
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
    heading: Float64 = np.clip((s % half - _STRAIGHT_M) / RADIUS_M, 0, None) + np.where(s >= half, np.pi, 0.0)
    return heading


def highway_lanes() -> list[Draft]:
    """All lanes: of the outer carriageway counter-clockwise, of the inner one clockwise."""
    return [_lane(way, segment, k) for way in (1, -1) for segment in range(NUM_SEGMENTS) for k in range(NUM_LANES)]


def lane_offset_m(k: int) -> float:
    """From the middle of the median to the k-th lane from the left."""
    return LEFT_EDGE_M + (k + 0.5) * LANE_M


def _lane(way: int, segment: int, k: int) -> Draft:
    step = LENGTH_M / NUM_SEGMENTS
    # Curves are longer outside: points are less than 1 m apart there too.
    num = int(np.ceil(step * (RADIUS_M + RIGHT_EDGE_M) / RADIUS_M)) + 1
    s = (segment + np.linspace(0, 1, num)) * step * way
    return Draft(
        (way, segment, k), lifted(ring_points(s, -way * lane_offset_m(k)), 0.0), "drive", LANE_M, SPEEDS_MPS[k],
        ((way, (segment + 1) % NUM_SEGMENTS, k),),
        left=(way, segment, k - 1) if k else None,
        right=(way, segment, k + 1) if k + 1 < NUM_LANES else None,
    )  # fmt: skip


BAY_M, BAY_WIDTH_M = 40.0, 1.8
"""Emergency bays: the shoulder is wider there."""
_PAINT_Z_M = 0.005
_DASH_M, _PERIOD_M = 6.0, 18.0
_LINE_M, _WIDE_M = 0.15, 0.30
_BEND_M = 6.0
"""Distance between corners of outlines: within 15 mm of the curve."""


def highway_regions(bays_m: Float64) -> tuple[Polygon, ...]:
    """Both carriageways with their shoulders and bays."""
    return tuple(Polygon("road", outline) for outline in (*_carriageways(), *_bays(bays_m)))


def highway_patches(seed: int, bays_m: Float64) -> list[Patch]:
    """Asphalt, median and markings; `bays_m` (B, 2) holds the bays' middles along the ring and their sides."""
    draw = generator(seed, "highway layout", "ground")
    roads = [Patch("asphalt", outline, 0.0, shade=float(draw.uniform(0.85, 1.1))) for outline in _carriageways()]
    bays = [Patch("asphalt", outline, 0.0, shade=0.9) for outline in _bays(bays_m)]
    half = MEDIAN_M / 2
    median = [Patch("grass", _strip(*span, -half, half), 0.0, shade=0.9) for span in _spans()]
    paint = [Patch("marking", outline, _PAINT_Z_M) for outline in _lines()]
    return [*roads, *bays, *median, *paint]


def _carriageways() -> list[Float64]:
    """Each from the median to the end of its shoulder, segment by segment."""
    sides = (-PAVED_M, -MEDIAN_M / 2), (MEDIAN_M / 2, PAVED_M)
    return [_strip(*span, right, left) for span in _spans() for right, left in sides]


def _bays(bays_m: Float64) -> list[Float64]:
    outlines = []
    for s, side in bays_m:
        inner, outer = side * PAVED_M, side * (PAVED_M + BAY_WIDTH_M)
        outlines.append(_strip(s - BAY_M / 2, s + BAY_M / 2, min(inner, outer), max(inner, outer)))
    return outlines


def _lines() -> list[Float64]:
    """Edge lines all around, dashes between lanes."""
    edges = [LEFT_EDGE_M - _LINE_M, RIGHT_EDGE_M]
    solid = [
        _strip(*span, *sorted((side * edge, side * (edge + width))))
        for span in _spans()
        for side in (-1, 1)
        for edge, width in zip(edges, (_LINE_M, _WIDE_M), strict=True)
    ]
    period = LENGTH_M / round(LENGTH_M / _PERIOD_M)
    dashes = [
        _strip(k * period, k * period + _DASH_M, left - _LINE_M / 2, left + _LINE_M / 2)
        for left in (side * (LEFT_EDGE_M + k * LANE_M) for side in (-1, 1) for k in range(1, NUM_LANES))
        for k in range(round(LENGTH_M / _PERIOD_M))
    ]
    return [*solid, *dashes]


def _spans() -> list[tuple[float, float]]:
    step = LENGTH_M / NUM_SEGMENTS
    return [(k * step, (k + 1) * step) for k in range(NUM_SEGMENTS)]


def _strip(from_m: float, to_m: float, right_m: float, left_m: float) -> Float64:
    """Outline (P, 2) along the ring between two offsets to its left."""
    s = np.linspace(from_m, to_m, int(np.ceil((to_m - from_m) / _BEND_M)) + 1)
    return np.concatenate([ring_points(s, right_m), ring_points(s[::-1], left_m)])
