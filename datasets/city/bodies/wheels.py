"""Wheels of cars, lorries and buses."""

from typing import Final

import numpy as np

from fbench.datasets.city.bodies.paints import BLACK, LINE, TYRE
from fbench.datasets.city.bodies.shell import mirrored, shell, shifted
from fbench.datasets.city.mesh import Mesh
from fbench.datasets.city.shapes import Skin

_SIDES: Final = 15
_RIM_SHARE: Final = 0.66
"""Of the wheel's radius."""
_GAP: Final = 3
"""Every so manyth sector of the rim is a gap between spokes."""


def wheel(radius_m: float, width_m: float, rim: Skin) -> Mesh:
    """Return a wheel that stands on the ground under the origin, its outer side towards +y."""
    angle = np.arange(_SIDES) * (2 * np.pi / _SIDES) - np.pi / 2
    half = width_m / 2
    rows = [(1.0, -half), (1.0, 0.8 * half), (_RIM_SHARE, half)]
    rings = np.stack([
        np.column_stack([-share * radius_m * np.cos(angle), np.full(_SIDES, y), share * radius_m * np.sin(angle)])
        for share, y in rows
    ])  # fmt: skip
    cells = np.zeros((len(rows) - 1, _SIDES), int)
    sectors = np.where(np.arange(_SIDES) % _GAP == 0, 2, 1)
    return shifted(shell(rings, cells, [TYRE, rim, LINE, BLACK], (3, sectors)), (0.0, 0.0, radius_m))


def axle(x_m: float, outer_m: float, radius_m: float, width_m: float, rim: Skin) -> list[Mesh]:
    """Return the two wheels at `x_m` whose outer sides are `outer_m` from the middle."""
    left = shifted(wheel(radius_m, width_m, rim), (x_m, outer_m - width_m / 2, 0.0))
    return [left, mirrored(left)]
