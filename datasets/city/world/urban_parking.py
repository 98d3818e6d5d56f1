"""Places for parked cars along the kerbs."""

import numpy as np

from fbench.datasets.city.world.city_map import Parking
from fbench.datasets.city.world.street_grid import PARKING_M, Arm, Grid

SPACE_M = 5.6
_FROM_M = 14.5
"""Along an arm; nearer to the junction, parked cars would hide people who cross."""


def parkings(grid: Grid) -> tuple[Parking, ...]:
    """All places; cars stand with the traffic beside them."""
    spaces = ((arm, space) for arm in grid.arm.values() for space in spaces_m(arm, grid.opposite(arm)))
    return tuple(_parking(arm, (start + end) / 2) for arm, (start, end) in spaces)


def _parking(arm: Arm, along_m: float) -> Parking:
    x, y = arm.at(along_m, arm.left_kerb_m - PARKING_M / 2)
    return Parking((float(x), float(y), 0.0), float((arm.yaw_rad + np.pi) % (2 * np.pi)), SPACE_M)


def spaces_m(arm: Arm, far: Arm) -> list[tuple[float, float]]:
    """Where along an arm the places on its left begin and end."""
    if arm.left_extra_m < PARKING_M:
        return []
    num = int((arm.length_to(far) - 2 * _FROM_M) / SPACE_M)
    start = (arm.length_to(far) - num * SPACE_M) / 2
    return [(start + k * SPACE_M, start + (k + 1) * SPACE_M) for k in range(num)]
