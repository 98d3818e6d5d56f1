"""Small layouts."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from fbench.datasets.city.mesh import Mesh
from fbench.datasets.city.world.city_map import CityMap, Layout, Patch, Placement, SignalPlan
from fbench.replay.data.arrays import Array, Float64

MakeLayout = Callable[[Sequence[Patch], Sequence[Placement]], Layout]


@pytest.fixture
def make_layout() -> MakeLayout:
    """Make a layout without lanes."""
    empty = CityMap("test", (), SignalPlan(60.0, np.zeros(0), np.zeros(0)), (), (), np.zeros((0, 3)))
    return lambda patches, placements: Layout(empty, tuple(patches), tuple(placements))


@pytest.fixture
def corners() -> Callable[[Mesh], Float64]:
    """Corners (T, 3, 3) of a mesh's triangles."""
    return lambda mesh: mesh.vertices_m.astype(np.float64)[mesh.triangles]


@pytest.fixture
def areas(corners: Callable[[Mesh], Float64]) -> Callable[[Mesh], Array]:
    """Areas (T,) of a mesh's triangles."""

    def measured(mesh: Mesh) -> Array:
        a, b, c = np.moveaxis(corners(mesh), 1, 0)
        cross: Array = np.cross(b - a, c - a)
        return np.asarray(np.linalg.norm(cross, axis=1) / 2)

    return measured
