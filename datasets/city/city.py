"""One city, built from a seed: the world as rays see it, and the traffic in it."""

from dataclasses import dataclass, replace

from fbench.datasets.city.rays.caster import EmbreeCaster
from fbench.datasets.city.rays.hits import RayCaster
from fbench.datasets.city.scenery.scenery import scenery
from fbench.datasets.city.spec import CitySpec, WorldName
from fbench.datasets.city.traffic.params import TrafficParams
from fbench.datasets.city.traffic.traffic import Traffic
from fbench.datasets.city.world.layout import Layout
from fbench.datasets.city.world.worlds import layout

_NUM_KEPT = 4
"""Both worlds of a seed, with normal and dense traffic."""


@dataclass(frozen=True, eq=False)
class City:
    """A world and the traffic that goes on in it."""

    layout: Layout
    caster: RayCaster
    traffic: Traffic

    def rewound(self) -> "City":
        """Return the same city with its traffic at the beginning again."""
        return replace(self, traffic=self.traffic.rewound())


class Cities:
    """Keeps the last few cities: weathers of one scene share one, and a city takes seconds to build."""

    def __init__(self) -> None:
        self._kept: dict[tuple[WorldName, bool, int], City] = {}

    def of(self, spec: CitySpec) -> City:
        """Return the city of a drive, with its traffic at the beginning."""
        key = (spec.world, spec.condition.is_dense, spec.seed)
        if key not in self._kept:
            if len(self._kept) == _NUM_KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = build_city(layout(spec.world, spec.seed), *key)
        return self._kept[key].rewound()


def build_city(plan: Layout, world: WorldName, is_dense: bool, seed: int) -> City:
    """Build the world of a plan with all who move in it; weather, sensors and length play no part in it."""
    traffic = Traffic(plan, TrafficParams.of(world, "dense" if is_dense else "normal"), seed)
    return City(plan, EmbreeCaster(scenery(plan, seed), traffic.actors), traffic)
