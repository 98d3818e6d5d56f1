"""Surfaces of a scene at an instant as arrays for the kernels, and a grid of what is near."""

from math import floor
from typing import NamedTuple

import numpy as np

from fbench.datasets.city.camera.samples import HitArrays
from fbench.datasets.city.camera.sky import Light
from fbench.datasets.city.mesh import INDEX, MATERIALS
from fbench.datasets.city.motion import BRAKE, EGO, BodyStates
from fbench.datasets.city.rays.hits import MISS, RayCaster
from fbench.replay.data.arrays import Array, Float32, Float64
from fbench.replay.geometry.kernels import kernel

_CELL_M = 4.0
_CELLS = 80
"""Along each side: 320 m."""


class Grid(NamedTuple):
    """Cells around a place; those of a row along y come one after the other."""

    x_m: float
    y_m: float
    """Its corner."""
    start: Array
    """(C + 1,) int64: where in `items` a cell's begin."""
    items: Array
    """Indices of what reaches into each cell, ascending."""


def grid_around(x_m: float, y_m: float, center_m: Float64, radius_m: Float64) -> Grid:
    """Return the cells around (x, y) with the discs that reach into them: centres (N, 2), radii (N,)."""
    corner = (x_m - _CELLS * _CELL_M / 2, y_m - _CELLS * _CELL_M / 2)
    low = np.floor((center_m - corner - radius_m[:, None]) / _CELL_M).astype(np.int64)
    high = np.floor((center_m - corner + radius_m[:, None]) / _CELL_M).astype(np.int64)
    low, high = np.clip(low, 0, _CELLS), np.clip(high, -1, _CELLS - 1)
    start, items = _filled(low, high)
    return Grid(corner[0], corner[1], start, items)


@kernel
def cell_of(corner_x_m: float, corner_y_m: float, x_m: float, y_m: float) -> int:
    """Return the cell of a place in the world, -1 outside, of a grid with this corner."""
    i, j = floor((x_m - corner_x_m) / _CELL_M), floor((y_m - corner_y_m) / _CELL_M)
    return int(i) * _CELLS + int(j) if 0 <= i < _CELLS and 0 <= j < _CELLS else -1


@kernel
def _filled(low: Array, high: Array) -> tuple[Array, Array]:
    start = np.zeros(_CELLS * _CELLS + 1, np.int64)
    for n in range(len(low)):
        for i in range(low[n, 0], high[n, 0] + 1):
            for j in range(low[n, 1], high[n, 1] + 1):
                start[i * _CELLS + j + 1] += 1
    start = np.cumsum(start)
    following, items = start[:-1].copy(), np.zeros(start[-1], np.int64)
    for n in range(len(low)):
        for i in range(low[n, 0], high[n, 0] + 1):
            for j in range(low[n, 1], high[n, 1] + 1):
                items[following[i * _CELLS + j]] = n
                following[i * _CELLS + j] += 1
    return start, items


GLOSS = np.array([material.gloss for material in MATERIALS])
EMITS = np.array([material.emits for material in MATERIALS])
RETRO = np.array([material.retro for material in MATERIALS])
_SOAKS = ("asphalt", "marking", "sidewalk", "concrete", "soil", "grass")
WETTABLE = np.array([1.0 if material.name in _SOAKS else 0.0 for material in MATERIALS])
"""(M,) of every material: share mirrored, luminance where it shines, what it returns to its source, whether rain makes
it dark and shiny."""
_BY_NIGHT = (INDEX["street_lamp"], INDEX["lit_window"])
_LAMP_OFF = 0.35
_SHADOW_M = 1.2
"""How far from a body the ground is a little darker."""


class Surfaces(NamedTuple):
    """Triangles of the static world, and of B bodies one after the other."""

    static_color: Float32
    static_lamp: Array
    color: Float32
    """(T, 3) of bodies."""
    lamp: Array
    start: Array
    """(B,) where a body's triangles begin."""
    place: Float64
    """(B, 7) of bodies: position, cosine and sine of yaw, half their length and width."""
    signals: Array
    """(L,) which lamps of the static world shine."""
    body_lamps: Array
    """(B, 3) which lamps of bodies do: brake, head and tail lights."""
    at_night: Array
    """(M,) materials that shine by night without being a lamp."""
    near: Grid
    """Which bodies are near."""


def surfaces_of(caster: RayCaster, states: BodyStates, light: Light) -> Surfaces:
    """Gather all surfaces at an instant."""
    bodies = [actor.body for actor in caster.actors]
    meshes = [body.phases[body.mesh_at(float(phase))] for body, phase in zip(bodies, states.phase, strict=True)]
    sizes = np.array([body.size_lwh_m[:2] for body in bodies]) / 2
    drives = np.array([not a.parked for a in caster.actors])
    lamps = np.repeat((drives & light.is_dim)[:, None], 3, axis=1)
    lamps[:, BRAKE] = states.braking
    at_night = np.zeros(len(MATERIALS), bool)
    at_night[list(_BY_NIGHT)] = light.is_dark
    ego = states.position_m[EGO]
    reach = np.sqrt((sizes * sizes).sum(axis=1)) + _SHADOW_M
    return Surfaces(
        caster.static.color, caster.static.lamp,
        np.concatenate([m.color for m in meshes]), np.concatenate([m.lamp for m in meshes]),
        np.cumsum([0, *(len(m) for m in meshes[:-1])]),
        np.column_stack([states.position_m, np.cos(states.yaw_rad), np.sin(states.yaw_rad), sizes]),
        states.lamps, lamps, at_night,
        grid_around(float(ego[0]), float(ego[1]), states.position_m[:, :2], reach),
    )  # fmt: skip


@kernel
def colors(surfaces: Surfaces, hits: HitArrays, emits: Array) -> tuple[Float32, Float32]:
    """Return albedo or colour of light (N, 3) of what was hit, and its luminance (N,) where it shines, else 0.

    `emits` is `EMITS`. Lamps that are off are dark.
    """
    body, triangle, material = hits.body, hits.triangle, hits.material
    static_color, static_lamp, color, lamp = surfaces.static_color, surfaces.static_lamp, surfaces.color, surfaces.lamp
    start, signals, body_lamps, at_night = surfaces.start, surfaces.signals, surfaces.body_lamps, surfaces.at_night
    albedo, shine = np.zeros((len(body), 3), np.float32), np.zeros(len(body), np.float32)
    for i in range(len(body)):
        if body[i] == MISS:
            continue
        m, of_world = material[i], body[i] < 0
        k = triangle[i] + (0 if of_world else start[body[i]])
        which = static_lamp[k] if of_world else lamp[k]
        for c in range(3):
            albedo[i, c] = static_color[k, c] if of_world else color[k, c]
        if emits[m] > 0:
            if of_world:
                shines = signals[which] if 0 <= which < len(signals) else at_night[m]
            else:
                shines = 0 <= which < 3 and body_lamps[body[i], which]
            if shines:
                shine[i] = emits[m]
            elif which >= 0:
                for c in range(3):
                    albedo[i, c] *= _LAMP_OFF
    return albedo, shine
