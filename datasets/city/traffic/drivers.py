"""What drivers, riders and walkers are like."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from fbench.datasets.city.traffic.network import BIKE, DRIVE, WALK


@dataclass(frozen=True)
class Driver:
    """What one mover is like: fields of `MOVER` of the same names, which says what they mean."""

    kind: int
    factor: float
    fastest_mps: float
    headway_s: float
    standing_gap_m: float
    acceleration_mps2: float
    braking_mps2: float
    margin_m: float
    keeps_right: bool = False
    cycle_m: float = 0.0


@dataclass(frozen=True)
class Habits:
    """Ranges from which a driver of one kind is drawn."""

    fastest_mps: tuple[float, float]
    headway_s: tuple[float, float]
    acceleration_mps2: tuple[float, float]
    braking_mps2: float
    standing_gap_m: float
    margin_m: float


HABITS: Final[Mapping[str, Habits]] = {
    "car": Habits((27.0, 38.0), (1.0, 1.6), (1.4, 2.0), 2.0, 2.0, 1.0),
    "van": Habits((25.0, 34.0), (1.1, 1.7), (1.0, 1.4), 2.0, 2.0, 1.0),
    "truck": Habits((22.2, 24.7), (1.4, 2.0), (0.6, 0.9), 1.6, 2.5, 1.2),
    "bus": Habits((24.0, 27.8), (1.4, 2.0), (0.7, 1.0), 1.6, 2.5, 1.2),
    "motorcycle": Habits((28.0, 40.0), (0.9, 1.5), (1.6, 2.4), 2.2, 1.8, 1.0),
    "bicycle": Habits((4.0, 6.0), (0.8, 1.2), (0.8, 1.2), 1.5, 1.0, 0.5),
    "pedestrian": Habits((1.0, 1.6), (0.4, 0.7), (0.8, 1.2), 1.2, 0.35, 0.15),
}
"""Around the typical values of Treiber, Kesting, "Traffic Flow Dynamics" (2013), table 11.2: T 1 s, s0 2 m, a 1 m/s^2,
b 1.5 m/s^2, with longer headways and slower starts of heavy vehicles (T 1.5 s and more). Bicycles and people on foot
follow the same rule with speeds typical of them (people: 1 to 1.6 m/s)."""
_STRIDE_M, _TALL_M, _PEDALS_M = 1.4, 1.75, 4.5
"""A cycle of two steps of a person this tall; what a turn of the pedals goes."""


def drawn_driver(label: str, height_m: float, spread: float, draw: np.random.Generator) -> Driver:
    """Draw whoever moves a body."""
    habits = HABITS[label]
    walks, rides = label == "pedestrian", label == "bicycle"
    factor = float(np.clip(draw.normal(1.0, spread), 0.8, 1.2))
    return Driver(
        WALK if walks else BIKE if rides else DRIVE,
        1.0 if walks or rides else factor,
        float(draw.uniform(*habits.fastest_mps)), float(draw.uniform(*habits.headway_s)),
        habits.standing_gap_m, float(draw.uniform(*habits.acceleration_mps2)), habits.braking_mps2, habits.margin_m,
        label in ("truck", "bus"),
        _STRIDE_M * height_m / _TALL_M if walks else _PEDALS_M if rides else 0.0,
    )  # fmt: skip
