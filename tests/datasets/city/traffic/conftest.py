"""Traffic of both worlds, simulated once."""

from typing import Literal

import numpy as np
import pytest

from fbench.datasets.city.instant import BodyStates
from fbench.datasets.city.spec import WorldName
from fbench.datasets.city.traffic.placing import TrafficParams
from fbench.datasets.city.traffic.traffic import Traffic
from fbench.datasets.city.world.city_map import Layout
from fbench.datasets.city.world.urban import layout

SECONDS = 90


class Scene:
    """A world, its traffic and all states of some time, every 0.1 s."""

    def __init__(self, world: WorldName, density: Literal["normal", "dense"], seed: int) -> None:
        self.layout: Layout = layout(world, seed)
        self.traffic = Traffic(self.layout, TrafficParams.of(world, density), seed)
        motion = self.traffic.motion(0.0, float(SECONDS))
        self.motion = motion
        self.states: list[BodyStates] = [motion.at(k / 10) for k in range(SECONDS * 10 + 1)]
        self.sizes = np.array([actor.body.size_lwh_m for actor in self.traffic.actors])
        self.labels = np.array([actor.body.label for actor in self.traffic.actors])
        self.parked = np.array([actor.parked for actor in self.traffic.actors])


@pytest.fixture(scope="session")
def urban() -> Scene:
    return Scene("urban", "normal", 5)


@pytest.fixture(scope="session")
def highway() -> Scene:
    return Scene("highway", "normal", 5)
