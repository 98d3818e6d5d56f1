"""The worlds by name."""

from fbench.datasets.city.spec import WorldName
from fbench.datasets.city.world.highway import highway_layout
from fbench.datasets.city.world.layout import Layout
from fbench.datasets.city.world.urban import urban_layout


def layout(world: WorldName, seed: int) -> Layout:
    """Lay out a world; the same for the same seed, another for another."""
    return urban_layout(seed) if world == "urban" else highway_layout(seed)
