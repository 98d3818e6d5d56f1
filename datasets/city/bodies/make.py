"""Every kind of road user by name."""

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from fbench.datasets.city.bodies.buses import make_bus, make_van
from fbench.datasets.city.bodies.cars import make_car
from fbench.datasets.city.bodies.lorries import make_truck
from fbench.datasets.city.bodies.people import make_pedestrian
from fbench.datasets.city.bodies.two_wheelers import make_bicycle, make_motorcycle
from fbench.datasets.city.mesh import Body
from fbench.replay.contracts.errors import ConfigError

_MAKERS: Final[Mapping[str, Callable[[np.random.Generator], Body]]] = {
    "car": make_car, "van": make_van, "truck": make_truck, "bus": make_bus, "motorcycle": make_motorcycle,
    "bicycle": make_bicycle, "pedestrian": make_pedestrian,
}  # fmt: skip
KINDS: Final = tuple(_MAKERS)  # Kinds of bodies; each is the label too


def make_body(kind: str, draw: np.random.Generator) -> Body:
    """Draw a body of a kind: its size, style and colors. Raises ConfigError where there is no such kind."""
    if kind not in _MAKERS:
        raise ConfigError(f"no road user {kind!r}: choose one of {', '.join(KINDS)}")
    return _MAKERS[kind](draw)
