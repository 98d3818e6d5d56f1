"""Small worlds for rays: a ground, a wall, a few boxes that drive."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from fbench.datasets.city.instant import BodyStates
from fbench.datasets.city.mesh import Actor, Body, Mesh, Skin, box, merge_meshes

MakeStates = Callable[..., BodyStates]


@pytest.fixture
def crate() -> Body:
    """A box of paint, 4 x 2 x 1.5 m."""
    return Body("car", (4.0, 2.0, 1.5), (box((0.0, 0.0, 0.75), (4.0, 2.0, 1.5), Skin("paint", (1.0, 0.0, 0.0))),))


@pytest.fixture
def crates(crate: Body) -> Callable[[int], tuple[Actor, ...]]:
    return lambda num: (Actor(crate),) * num


@pytest.fixture
def nothing() -> Mesh:
    return merge_meshes([])


@pytest.fixture
def states() -> MakeStates:
    """States of bodies from rows of x, y, yaw, velocity x and y, yaw rate."""

    def make(rows: Sequence[Sequence[float]], phase: Sequence[float] | None = None) -> BodyStates:
        table = np.zeros((len(rows), 6))
        for i, row in enumerate(rows):
            table[i, : len(row)] = row
        num, flat = len(rows), np.zeros(len(rows))
        return BodyStates(
            0.0, np.column_stack([table[:, :2], flat]), table[:, 2].copy(), np.column_stack([table[:, 3:5], flat]),
            table[:, 5].copy(), flat if phase is None else np.array(phase), np.zeros(num, bool), np.zeros(0, bool),
        )  # fmt: skip

    return make
