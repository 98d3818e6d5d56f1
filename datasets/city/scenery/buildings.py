"""Buildings: four facades and a roof, filling a box."""

from dataclasses import replace

import numpy as np

from fbench.datasets.city.mesh import Mesh, merged
from fbench.datasets.city.scenery.facade import facade
from fbench.datasets.city.scenery.quads import Quads, above, joined, on_wall, quads_mesh
from fbench.datasets.city.scenery.style import Style, draw_style
from fbench.datasets.city.shapes import Skin, Three, box, mesh
from fbench.replay.arrays import Float64

_INSET_M = 0.12
"""Walls stand back from the box by this much: cornice and step fill it."""
_DEEP_INSET_M = 0.85
"""The front's, where balconies or awnings stand out."""


def building(size_lwh_m: Three, rng: np.random.Generator) -> Mesh:
    """Return a building in its own coordinates: front towards x, origin in the middle of its foot."""
    length, width, height = size_lwh_m
    style = draw_style(size_lwh_m, rng)
    if length < 6:
        style = replace(style, balconies=False, awnings=False)
    front = _DEEP_INSET_M if style.stands_out else _INSET_M
    core = np.array([-length / 2 + _INSET_M, length / 2 - front, -width / 2 + _INSET_M, width / 2 - _INSET_M])
    has_shed = not style.pitched and height > 9 and bool(rng.random() < 0.6)
    rise = min(0.32 * min(length, width), 0.4 * height) if style.pitched else 2.2 if has_shed else 0.0
    eaves = height - rise
    walls = quads_mesh(joined([_side(core, k, eaves, style, rng) for k in range(4)]))
    step = box((0.0, 0.0, 0.04), (length, width, 0.08), style.trim)
    if style.pitched:
        return merged([walls, step, *_gable(core, eaves, height, style, rng)])
    return merged([walls, step, *_flat_roof(core, eaves, style), *([_shed(core, eaves, height, style)] * has_shed)])


def _side(core: Float64, k: int, eaves: float, style: Style, rng: np.random.Generator) -> Quads:
    """Wall `k`: front, left, back, right."""
    x0, x1, y0, y1 = core.tolist()
    foot = [(x1, y0), (x1, y1), (x0, y1), (x0, y0)][k]
    wide = y1 - y0 if k % 2 == 0 else x1 - x0
    return on_wall(facade(wide, eaves, style, k == 0, rng), (*foot, 0.0), k * np.pi / 2)


def _flat_roof(core: Float64, eaves: float, style: Style) -> list[Mesh]:
    """A roof below a parapet, which is a cornice as well."""
    x0, x1, y0, y1 = core.tolist()
    high = 0.5
    outer, thick = _INSET_M, _INSET_M + 0.25
    z = eaves - high / 2
    xm, ym, long, wide = (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0 + 2 * outer, y1 - y0 + 2 * outer
    ring = [
        box((x1 + outer - thick / 2, ym, z), (thick, wide, high), style.trim),
        box((x0 - outer + thick / 2, ym, z), (thick, wide, high), style.trim),
        box((xm, y1 + outer - thick / 2, z), (long - 2 * thick, thick, high), style.trim),
        box((xm, y0 - outer + thick / 2, z), (long - 2 * thick, thick, high), style.trim),
    ]
    top = above(y0, y1, x0, x1, eaves - high + 0.1, Skin("concrete", (0.2, 0.2, 0.2)))
    return [*ring, quads_mesh(on_wall(top, (0.0, 0.0, 0.0), 0.0))]


def _shed(core: Float64, eaves: float, height: float, style: Style) -> Mesh:
    """What houses the lift on the roof."""
    x0, x1, y0, y1 = core.tolist()
    size = (min(4.0, 0.4 * (x1 - x0)), min(5.0, 0.4 * (y1 - y0)), height - eaves + 0.5)
    return box(((x0 + x1) / 2, (y0 + y1) / 2 + 0.2 * (y1 - y0), height - size[2] / 2), size, style.wall)


def _gable(core: Float64, eaves: float, height: float, style: Style, rng: np.random.Generator) -> list[Mesh]:
    """A pitched roof along the longer side, with a chimney up to the building's height."""
    x0, x1, y0, y1 = (core + np.array([-1, 1, -1, 1]) * _INSET_M).tolist()
    ridge = height - 0.6
    xm, ym = (x0 + x1) / 2, (y0 + y1) / 2
    corners = [(x0, y0, eaves), (x1, y0, eaves), (x1, y1, eaves), (x0, y1, eaves)]
    if y1 - y0 > x1 - x0:
        vertices = np.array([*corners, (xm, y0, ridge), (xm, y1, ridge)])
        slopes, ends = [[1, 2, 5], [1, 5, 4], [3, 0, 4], [3, 4, 5]], [[0, 1, 4], [2, 3, 5]]
    else:
        vertices = np.array([*corners, (x0, ym, ridge), (x1, ym, ridge)])
        slopes, ends = [[0, 1, 5], [0, 5, 4], [2, 3, 4], [2, 4, 5]], [[1, 2, 5], [3, 0, 4]]
    soffit = [[0, 3, 2], [0, 2, 1]]
    along = float(rng.uniform(-0.3, 0.3))
    chimney = box((xm + along * (x1 - x0) * 0.6, ym + along * (y1 - y0) * 0.6, (eaves + height) / 2),
                  (0.6, 0.7, height - eaves), Skin("brick", (0.2, 0.09, 0.06)))  # fmt: skip
    return [
        mesh(vertices, np.array(slopes), style.roof),
        mesh(vertices, np.array(ends), style.wall),
        mesh(vertices, np.array(soffit), style.trim),
        chimney,
    ]
