"""Daylight on surfaces: the sun, the sky above, the ground below."""

import math

import numpy as np

from fbench.datasets.city.camera.light import Light
from fbench.datasets.city.camera.near import cell_of
from fbench.datasets.city.camera.samples import HitArrays
from fbench.datasets.city.camera.surfaces import Surfaces
from fbench.datasets.city.rays.hits import MISS
from fbench.replay.arrays import Array, Float32
from fbench.replay.kernels import kernel

GROUND = 0.16
"""Typical albedo of the ground, which lights what hangs over it."""
_SPILL = 0.4 / 50_000
"""Illuminance by a lit street from all around, by night."""


@kernel
def daylight(hits: HitArrays, origin: Array, light: Light, surfaces: Surfaces) -> Float32:
    """Return the illuminance (N, 3) of all hits, in units of daylight."""
    range_m, body, direction, normal, lit = hits.range_m, hits.body, hits.direction, hits.normal, hits.lit
    place, start, items = surfaces.place, surfaces.near.start, surfaces.near.items
    x_m, y_m = surfaces.near.x_m, surfaces.near.y_m
    result, high = np.zeros((len(body), 3), np.float32), max(0.0, light.sun[2])
    spill = _SPILL if light.is_dark else 0.0
    for i in range(len(body)):
        if body[i] == MISS:
            continue
        r, nz = float(range_m[i]), float(normal[i, 2])
        x, y, z = origin[0] + r * direction[i, 0], origin[1] + r * direction[i, 1], origin[2] + r * direction[i, 2]
        if body[i] >= 0:
            share = 1.0 if nz >= 0.5 else min(1.0, 0.45 + 0.9 * max(0.0, z - place[body[i], 2]))
        else:
            share = 1.0 if nz > 0.7 else 0.75 + 0.25 * min(1.0, max(0.0, z / 2.0))
            cell = cell_of(x_m, y_m, x, y)
            for k in range(start[cell], start[cell + 1] if cell >= 0 else start[cell]):
                share *= _beside(place, items[k], x, y, z)
        above, below = (0.5 + 0.5 * nz) * share, (0.5 - 0.5 * nz) * share * GROUND
        sun = normal[i, 0] * light.sun[0] + normal[i, 1] * light.sun[1] + nz * light.sun[2]
        direct = (max(0.0, sun) if lit[i] else 0.0) + below * high
        for c in range(3):
            result[i, c] = light.ambient[c] * (above + below) + light.direct[c] * direct + spill
    return result


@kernel
def _beside(place: Array, b: int, x: float, y: float, z: float) -> float:
    """Return the share of the sky's light that a body leaves to static ground near it: little below its middle."""
    if abs(z - place[b, 2]) > 0.4:
        return 1.0
    dx, dy = x - place[b, 0], y - place[b, 1]
    along = abs(dx * place[b, 3] + dy * place[b, 4]) - place[b, 5]
    across = abs(dy * place[b, 3] - dx * place[b, 4]) - place[b, 6]
    if along <= 0 and across <= 0:
        return float(0.38 - 0.33 * min(1.0, -max(along, across) / 0.4))
    along, across = max(along, 0.0), max(across, 0.0)
    return float(1 - 0.62 * max(0.0, math.exp(-math.sqrt(along * along + across * across) / 0.3) - 0.02))
