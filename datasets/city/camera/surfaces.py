"""Surfaces of a scene as arrays for the kernels, a grid of what is near, and the textures of materials.

A texture depends on the place on the surface alone, so that both cameras of a stereo pair see the same, and is only as
fine as a pixel can show, so that it doesn't flicker.
"""

import math
from math import floor
from typing import NamedTuple

import numpy as np

from fbench.datasets.city.camera.samples import HitArrays
from fbench.datasets.city.camera.sky import Light, hash_noise, value_noise
from fbench.datasets.city.instant import BRAKE, EGO, MISS, BodyStates
from fbench.datasets.city.mesh import INDEX, MATERIALS
from fbench.datasets.city.rays.caster import EmbreeCaster
from fbench.replay.data.arrays import Array, Float32, Float64
from fbench.replay.geometry.kernels import kernel, kernel_part

_CELL_M, _CELLS = 4.0, 80  # Along each side: 320 m


class Grid(NamedTuple):
    """Cells around a place; those of a row along y come one after the other."""

    x_m: float
    y_m: float  # Its corner
    start: Array  # (C + 1,) int64: where in `items` a cell's begin
    items: Array  # Indices of what reaches into each cell, ascending


def grid_around(x_m: float, y_m: float, center_m: Float64, radius_m: Float64) -> Grid:
    """Return the cells around (x, y) with the discs that reach into them: centers (N, 2), radii (N,)."""
    corner = (x_m - _CELLS * _CELL_M / 2, y_m - _CELLS * _CELL_M / 2)
    low = np.floor((center_m - corner - radius_m[:, None]) / _CELL_M).astype(np.int64)
    high = np.floor((center_m - corner + radius_m[:, None]) / _CELL_M).astype(np.int64)
    return Grid(*corner, *_fill(np.clip(low, 0, _CELLS), np.clip(high, -1, _CELLS - 1)))


@kernel_part
def cell_of(corner_x_m: float, corner_y_m: float, x_m: float, y_m: float) -> int:
    """Return the cell of a place in the world, -1 outside, of a grid with this corner."""
    i, j = floor((x_m - corner_x_m) / _CELL_M), floor((y_m - corner_y_m) / _CELL_M)
    return int(i) * _CELLS + int(j) if 0 <= i < _CELLS and 0 <= j < _CELLS else -1


@kernel
def _fill(low: Array, high: Array) -> tuple[Array, Array]:
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


GLOSS, EMITS, RETRO = (np.array([getattr(m, name) for m in MATERIALS]) for name in ("gloss", "emits", "retro"))
_SOAKS = ("asphalt", "marking", "sidewalk", "concrete", "soil", "grass")
WETTABLE = np.array([1.0 if material.name in _SOAKS else 0.0 for material in MATERIALS])
"""(M,) of every material: share mirrored, luminance where it shines, what it returns to its source, whether rain makes
it dark and shiny."""
_BY_NIGHT, _LAMP_OFF = (INDEX["street_lamp"], INDEX["lit_window"]), 0.35
_SHADOW_M = 1.2  # How far from a body the ground is a little darker


class Surfaces(NamedTuple):
    """Triangles of the static world, and of B bodies one after the other."""

    static_color: Float32
    static_lamp: Array
    color: Float32  # (T, 3) of bodies
    lamp: Array
    start: Array  # (B,) where a body's triangles begin
    place: Float64  # (B, 7) of bodies: position, cosine and sine of yaw, half their length and width
    signals: Array  # (L,) which lamps of the static world shine
    body_lamps: Array  # (B, 3) which lamps of bodies do: brake, head and tail lights
    at_night: Array  # (M,) materials that shine by night without being a lamp
    near: Grid  # Which bodies are near


def surfaces_of(caster: EmbreeCaster, states: BodyStates, light: Light) -> Surfaces:
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
    """Return albedo or color of light (N, 3) of what was hit, and its luminance (N,) where it shines, else 0. `emits`
    is `EMITS`. Lamps that are off are dark.
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


_FINEST, _GRAIN, _STAIN, _STAIN_M, _ALONG, _ACROSS, _JOINT, _PIECE, _SEAM = range(9)


class _Texture(NamedTuple):
    finest_m: float  # Size of the smallest grains
    grain: float  # How strong every octave of grain is
    stain: float = 0.0
    stain_m: float = 1.0  # Strength and size of stains
    along_m: float = 0.0
    across_m: float = 0.0  # Size of the pieces, bricks or slabs, of which it is laid; 0: of none
    joint_m: float = 0.0
    piece: float = 0.0  # How much pieces differ
    seam: float = 1.0  # How light joints are


_TEXTURES = {
    "plain": _Texture(0.006, 0.035, 0.03, 0.7),
    "asphalt": _Texture(0.006, 0.15, 0.16, 2.3),
    "concrete": _Texture(0.004, 0.10, 0.14, 1.1),
    "brick": _Texture(0.004, 0.08, 0.10, 1.7, 0.25, 0.075, 0.010, 0.22, 1.45),
    "grass": _Texture(0.012, 0.26, 0.22, 1.9),
    "leaves": _Texture(0.025, 0.42, 0.20, 0.9),
    "bark": _Texture(0.008, 0.22, 0.15, 0.3),
    "cloth": _Texture(0.006, 0.10, 0.10, 0.15),
    "tiles": _Texture(0.005, 0.08, 0.08, 1.5, 0.40, 0.40, 0.012, 0.12, 0.55),
    "soil": _Texture(0.008, 0.20, 0.22, 1.3),
}
TEXTURES = np.array([_TEXTURES[material.texture] for material in MATERIALS], np.float64)
"""(M, 9) by material: the fields of `_Texture`."""
_OCTAVES = 4
_FEWEST_PX = 1.4  # Size of the finest grains that are drawn
_COARSEST_M = 1.0  # Grains of twice this size are none: larger patterns are stains
_ROOT_OF_2 = math.sqrt(2)


@kernel
def patterns(hits: HitArrays, origin: Array, place: Array, size_px: float, table: Array) -> Float32:
    """Return the factor (N,) on the albedo of each hit. `place` (B, 5) is where bodies are: position, cosine and sine
    of yaw, with which their patterns move along; a pixel in the middle of the image covers `size_px` [rad]; `table` is
    `TEXTURES`.
    """
    range_m, body, direction, normal, material = hits.range_m, hits.body, hits.direction, hits.normal, hits.material
    result = np.ones(len(body), np.float32)
    for i in range(len(body)):
        if body[i] == MISS:
            continue
        r, salt = float(range_m[i]), material[i] * 131
        dx, dy, dz = float(direction[i, 0]), float(direction[i, 1]), float(direction[i, 2])
        nx, ny, nz = float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2])
        facing = max(0.02, -(dx * nx + dy * ny + dz * nz))
        x, y, z = origin[0] + r * dx, origin[1] + r * dy, origin[2] + r * dz
        b = body[i]
        if b >= 0:
            x, y, z = x - place[b, 0], y - place[b, 1], z - place[b, 2]
            x, y = x * place[b, 3] + y * place[b, 4], y * place[b, 3] - x * place[b, 4]
            nx, ny = nx * place[b, 3] + ny * place[b, 4], ny * place[b, 3] - nx * place[b, 4]
            salt += 7919 * (b + 1)
        across = math.sqrt(nx * nx + ny * ny)
        u, v = (x, y) if across < 0.7 else ((nx * y - ny * x) / across, z)  # seen from above, else along a wall
        result[i] = pattern(table, material[i], u, v, r * size_px, r * size_px / facing, salt)
    return result


@kernel_part
def pattern(table: Array, row: int, u: float, v: float, minor_m: float, major_m: float, salt: int) -> float:
    """Return the factor on the albedo at place (u, v) [m] of a surface, of which a pixel covers `minor_m` x `major_m`.
    Surfaces of different salts have different patterns.
    """
    grain = _grain(table[row, _FINEST], u, v, minor_m, major_m, salt)
    size = table[row, _STAIN_M]
    fade = min(1.0, size / (2 * minor_m))
    stain = table[row, _STAIN] * fade * value_noise(u / size + 3.3, v / size - 5.1, salt + 40)
    factor = 1.0 + table[row, _GRAIN] * grain + stain
    along, across = table[row, _ALONG], table[row, _ACROSS]
    pixel_m = math.sqrt(minor_m * major_m)
    if along > 0 and pixel_m < 0.5 * across:
        piece, seam = table[row, _PIECE], table[row, _SEAM]
        factor *= _lay_pieces(along, across, table[row, _JOINT], piece, seam, u, v, pixel_m, salt)
    return float(max(0.1, factor))


@kernel_part
def _grain(finest_m: float, u: float, v: float, minor_m: float, major_m: float, salt: int) -> float:
    """Sum octaves from about two pixels up; what a pixel averages over many grains keeps the root of their number."""
    first, size, wanted = 0, finest_m, _FEWEST_PX * minor_m
    while 2 * size <= wanted:
        first, size = first + 1, 2 * size
    scale, shown, total = 1 / size, math.sqrt(size / major_m), 0.0
    for octave in range(_OCTAVES):
        weight = min(1.0, shown) * min(1.0, 2.0 - size / _COARSEST_M)
        if weight <= 0:
            break
        if octave == 0 and wanted > size:
            weight *= 2 - wanted / size
        shift = 17.0 * (first + octave)
        total += weight * value_noise(u * scale + shift, v * scale - shift, salt + first + octave)
        scale, size = 0.5 * scale, 2 * size
        shown *= _ROOT_OF_2
    return total


@kernel_part
def _lay_pieces(
    along: float, across: float, joint: float, piece: float, seam: float, u: float, v: float, pixel_m: float, salt: int
) -> float:
    """Rows of pieces with joints, every other row shifted by half a piece; faded where pixels don't show them."""
    fade = min(1.0, 2.0 - 4.0 * pixel_m / across)
    row = math.floor(v / across)
    x = u / along + 0.5 * (int(row) & 1)
    column = math.floor(x)
    edge = min(min(x - column, column + 1 - x) * along, min(v / across - row, row + 1 - v / across) * across)
    soft = 0.5 * pixel_m + 1e-4
    inside = min(1.0, max(0.0, (edge - 0.5 * joint + soft) / (2 * soft)))
    shade = 1 + piece * hash_noise(int(column), int(row), salt + 80)
    return 1 + fade * (shade * inside + seam * (1 - inside) - 1)
