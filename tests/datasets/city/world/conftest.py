"""Worlds that several tests look at, and what they share."""

import pytest

from fbench.datasets.city.world.city_map import Layout
from fbench.datasets.city.world.urban import layout

SEEDS = (0, 1, 2, 7)


@pytest.fixture(scope="session", params=SEEDS, ids=lambda seed: f"seed-{seed}")
def urban(request: pytest.FixtureRequest) -> Layout:
    """Urban worlds of several seeds."""
    return layout("urban", request.param)


@pytest.fixture(scope="session")
def highway() -> Layout:
    """A highway."""
    return layout("highway", 0)
