"""The world at the instant of one measurement."""

from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.motion import EGO, BodyStates
from fbench.datasets.city.rays.hits import RayCaster
from fbench.replay.conditions.generators import generator
from fbench.replay.conditions.weather import Weather
from fbench.replay.data.arrays import Float64
from fbench.replay.geometry.transforms import chained


@dataclass(frozen=True, eq=False)
class Instant:
    """The world around one sensor when it measures; what it is like itself is said by its spec."""

    caster: RayCaster
    states: BodyStates
    """Of all bodies at `stamp_ns`."""
    weather: Weather
    street_lamps_m: Float64
    """(L, 3) in the world."""
    seed: int
    """Of all chances."""
    sensor: str
    """Its name."""
    body_T_sensor: Float64
    """(4, 4) its mount on the ego vehicle."""
    stamp_ns: int
    log_ns: int
    """When the message arrives."""

    @property
    def world_T_sensor(self) -> Float64:
        """Pose (4, 4) of the sensor in the world."""
        return chained(self.states.world_T_body(EGO), self.body_T_sensor)

    def draws(self, what: str, *scope: str) -> np.random.Generator:
        """Return the random numbers for `what` in the sensor's one message."""
        return generator(self.seed, what, self.sensor, self.stamp_ns, *scope)
