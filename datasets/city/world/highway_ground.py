"""The highway's ground: asphalt, median and markings, as patches and as regions."""

import numpy as np

from fbench.datasets.city.world.city_map import Polygon
from fbench.datasets.city.world.highway_lanes import (
    LANE_M,
    LEFT_EDGE_M,
    LENGTH_M,
    MEDIAN_M,
    NUM_LANES,
    NUM_SEGMENTS,
    PAVED_M,
    RIGHT_EDGE_M,
    ring_points,
)
from fbench.datasets.city.world.layout import Patch
from fbench.replay.arrays import Float64
from fbench.replay.draws import generator

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
