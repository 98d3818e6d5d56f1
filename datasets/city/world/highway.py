"""The highway: a closed ring of two carriageways with barriers, gantries and what grows beside it."""

import numpy as np

from fbench.datasets.city.world.city_map import CityMap, Parking, SignalPlan
from fbench.datasets.city.world.highway_furniture import highway_furniture, highway_lamps_m
from fbench.datasets.city.world.highway_ground import BAY_WIDTH_M, highway_patches, highway_regions
from fbench.datasets.city.world.highway_lanes import LENGTH_M, PAVED_M, highway_lanes, ring_heading, ring_points
from fbench.datasets.city.world.lane_graph import joined
from fbench.datasets.city.world.layout import Layout
from fbench.replay.arrays import Float64
from fbench.replay.draws import generator

_BAYS = 4
"""Emergency bays of each carriageway."""
_STANDING_M = 14.0
"""Length of a place in a bay: even a bus may have broken down."""


def highway_layout(seed: int) -> Layout:
    """Lay out the ring: two straights of 0.9 km and two half circles."""
    no_signals = SignalPlan(60.0, np.zeros(0), np.zeros(0))
    bays_m = _drawn_bays(seed)
    city_map = CityMap(
        "highway",
        joined(highway_lanes()),
        no_signals,
        highway_regions(bays_m),
        _parkings(bays_m),
        highway_lamps_m(seed, bays_m),
    )
    return Layout(city_map, tuple(highway_patches(seed, bays_m)), tuple(highway_furniture(seed, bays_m)))


def _drawn_bays(seed: int) -> Float64:
    """Middles along the ring and sides (B, 2): -1 outside, where traffic goes counter-clockwise, 1 inside."""
    draw = generator(seed, "highway layout", "bays")
    spacing = LENGTH_M / _BAYS
    return np.array([[(k + float(draw.uniform(0.1, 0.9))) * spacing, side] for side in (-1, 1) for k in range(_BAYS)])


def _parkings(bays_m: Float64) -> tuple[Parking, ...]:
    spots = [ring_points(np.array([s]), side * (PAVED_M + BAY_WIDTH_M / 2 - 0.6))[0] for s, side in bays_m]
    yaws = ring_heading(bays_m[:, 0]) + np.where(bays_m[:, 1] > 0, np.pi, 0.0)
    return tuple(
        Parking((float(x), float(y), 0.0), float(yaw % (2 * np.pi)), _STANDING_M)
        for (x, y), yaw in zip(spots, yaws, strict=True)
    )
