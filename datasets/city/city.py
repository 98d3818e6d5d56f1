"""One city, built from a seed: the world as rays see it, and the traffic in it."""

from dataclasses import dataclass

from fbench.datasets.city.rays.caster import EmbreeCaster
from fbench.datasets.city.rays.hits import RayCaster
from fbench.datasets.city.scenery.scenery import scenery
from fbench.datasets.city.spec import WorldName
from fbench.datasets.city.traffic.params import TrafficParams
from fbench.datasets.city.traffic.traffic import Traffic
from fbench.datasets.city.world.layout import Layout


@dataclass(frozen=True, eq=False)
class City:
    """A world and the traffic that goes on in it."""

    layout: Layout
    caster: RayCaster
    traffic: Traffic


def build_city(plan: Layout, world: WorldName, is_dense: bool, seed: int) -> City:
    """Build the world of a plan with all who move in it; weather, sensors and length play no part in it."""
    traffic = Traffic(plan, TrafficParams.of(world, "dense" if is_dense else "normal"), seed)
    return City(plan, EmbreeCaster(scenery(plan, seed), traffic.actors), traffic)
