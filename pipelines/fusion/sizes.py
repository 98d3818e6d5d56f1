"""Sizes of objects by class: one table, with a column for each use."""

import math
from typing import NamedTuple


class ObjectSize(NamedTuple):
    """Typical size of the objects of one class, and limits."""

    length_m: float
    width_m: float
    height_m: float  # As cameras see it in 3D fusion, where detectors also call vans trucks and buses
    height_spread: float  # Relative spread of heights
    image_height_m: float  # Height from which the distance of a camera's box is guessed in images
    lidar_lwh_m: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    """Length, width and height to which partly seen LiDAR clusters are completed, by default; NaN: it knows none."""
    longest_m: float = math.inf
    highest_m: float = math.inf
    """No object of this class is longer or higher; cameras mistake cars and vans for each other, trucks for both."""

    @property
    def lwh_m(self) -> tuple[float, float, float]:
        """Length, width and height in 3D fusion."""
        return self[:3]


LONG_CAR_M, LONG_M, HIGH_VAN_M = 5.6, 7.0, 1.95
"""Objects that no camera labels are called trucks where they are longer than `LONG_M`, else cars; late fusion in 3D
calls those vans that are longer than `LONG_CAR_M` and higher than `HIGH_VAN_M`."""
LONGEST_M = 18.75  # Of a vehicle on the roads of the EU (Directive 96/53/EC, Annex I, 1.1) [m]
LOW_TRUCK_M = 2.5  # A truck or bus that turns out lower than this [m] is a van

SIZES = {
    #                        length width height spread  image  LiDAR            limits
    "car": ObjectSize(4.2, 1.8, 1.55, 0.15, 1.55, (4.2, 1.8, 1.6), LONG_CAR_M, 2.1),
    "van": ObjectSize(5.0, 2.0, 2.1, 0.2, 2.1, (5.3, 2.1, 2.2), LONG_M, 2.8),
    "truck": ObjectSize(8.0, 2.5, 3.0, 0.4, 3.3, (8.5, 2.6, 3.3)),
    "bus": ObjectSize(12.0, 2.6, 3.0, 0.4, 3.1),
    "trailer": ObjectSize(8.0, 2.5, 3.2, 0.4, 3.3),
    "motorcycle": ObjectSize(2.1, 0.8, 1.5, 0.2, 1.5, (2.1, 0.8, 1.6)),
    "bicycle": ObjectSize(1.8, 0.6, 1.6, 0.2, 1.6, (1.8, 0.6, 1.7)),
    "pedestrian": ObjectSize(0.6, 0.6, 1.7, 0.15, 1.7, (0.6, 0.6, 1.7)),
}
