"""The worlds by name."""

from typing import Literal

from fbench.datasets.city.world.highway import highway_layout
from fbench.datasets.city.world.layout import Layout
from fbench.datasets.city.world.urban import urban_layout


def layout(world: Literal["urban", "highway"], seed: int) -> Layout:
    """Lay out a world; the same for the same seed, another for another."""
    return urban_layout(seed) if world == "urban" else highway_layout(seed)
