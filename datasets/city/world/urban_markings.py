"""What is painted on the urban world's streets, as thin patches above the asphalt."""

from collections.abc import Iterator

import numpy as np

from fbench.datasets.city.world.layout import Patch
from fbench.datasets.city.world.street_grid import BIKE_M, LANE_M, PARKING_M, STOP_M, Arm, Grid
from fbench.datasets.city.world.urban_drives import lane_offset_m
from fbench.datasets.city.world.urban_parking import spaces_m
from fbench.datasets.city.world.urban_walks import CROSSING_M
from fbench.replay.arrays import Float64

PAINT_Z_M, ARROW_Z_M = 0.005, 0.008
_LINE_M, _THIN_M = 0.15, 0.10
_DASH_M, _GAP_M = 3.0, 4.0
_STOP_LINE_M = (11.8, 12.2)
"""Along an arm, just beyond the lanes' ends."""


def marking_patches(grid: Grid) -> list[Patch]:
    """Markings of all streets."""
    arms = list(grid.arm.values())
    centre = [outline for arm in arms if arm.way < 2 for outline in _centre_line(arm, grid.opposite(arm))]
    sides = [outline for arm in arms for outline in _left_side(arm, grid.opposite(arm))]
    ends = [outline for arm in arms for outline in (*_zebra(arm), *_stop_lines(arm))]
    arrows = [outline for arm in arms if arm.num_lanes > 1 for outline in _arrows(grid, arm)]
    return [
        *(Patch("marking", outline, PAINT_Z_M) for outline in (*centre, *sides, *ends)),
        *(Patch("marking", outline, ARROW_Z_M) for outline in arrows),
    ]


def _centre_line(arm: Arm, far: Arm) -> Iterator[Float64]:
    end = arm.length_to(far) - STOP_M
    if arm.num_lanes > 1:
        yield from (_bar(arm, (STOP_M, end), (o - _THIN_M / 2, o + _THIN_M / 2)) for o in (-0.12, 0.12))
    else:
        yield from _dashes(arm, end, 0.0)


def _left_side(arm: Arm, far: Arm) -> Iterator[Float64]:
    """Lane lines, the edge of the drive lanes, and parking spaces on the left side of an arm."""
    end = arm.length_to(far) - STOP_M
    for k in range(1, arm.num_lanes):
        yield from _dashes(arm, end, k * LANE_M)
    yield _bar(arm, (STOP_M, end), (arm.half_m - _LINE_M / 2, arm.half_m + _LINE_M / 2))
    parking = arm.left_kerb_m - PARKING_M
    spaces = spaces_m(arm, far)
    if spaces and arm.left_extra_m > PARKING_M:
        yield _bar(arm, (STOP_M, end), (parking - _THIN_M, parking))
    for s in sorted({s for space in spaces for s in space}):
        yield _bar(arm, (s - _THIN_M / 2, s + _THIN_M / 2), (parking + 0.1, parking + PARKING_M - 0.05))


def _dashes(arm: Arm, end_m: float, left_m: float) -> Iterator[Float64]:
    for start in np.arange(STOP_M, end_m - _DASH_M, _DASH_M + _GAP_M):
        yield _bar(arm, (float(start), float(start) + _DASH_M), (left_m - _THIN_M / 2, left_m + _THIN_M / 2))


def _zebra(arm: Arm) -> Iterator[Float64]:
    """Bars of 0.5 m across the whole street."""
    num = int((arm.left_kerb_m + arm.right_kerb_m) - 0.3)
    middle = (arm.left_kerb_m - arm.right_kerb_m) / 2
    for k in range(num):
        o = middle + k - (num - 1) / 2
        yield _bar(arm, CROSSING_M, (o - 0.25, o + 0.25))


def _stop_lines(arm: Arm) -> Iterator[Float64]:
    yield _bar(arm, _STOP_LINE_M, (0.2, arm.half_m - 0.2))
    if arm.has_bikes:
        yield _bar(arm, _STOP_LINE_M, (arm.half_m + 0.2, arm.half_m + BIKE_M - 0.2))


def _arrows(grid: Grid, arm: Arm) -> Iterator[Float64]:
    """On avenues: straight on from each lane that goes there, with a branch for the turn that it also allows."""
    ways = {(exit_.way - arm.way) % 4 for exit_ in grid.arms(arm.node)}
    for k in range(arm.num_lanes):
        o = lane_offset_m(k)
        turn = 3 if k == 0 else 1
        side = {3: -1.0, 1: 1.0}[turn]  # seen outwards, the driver's left is on our right
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
