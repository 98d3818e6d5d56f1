"""Lanes of the highway: a closed ring with two carriageways of three lanes."""

import numpy as np

from fbench.datasets.city.world.lane_graph import Draft
from fbench.datasets.city.world.lane_paths import lifted
from fbench.replay.arrays import Float64

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
