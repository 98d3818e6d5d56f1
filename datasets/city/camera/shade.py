"""Shading: how bright what rays hit looks by daylight and lamps."""

import math
from typing import NamedTuple

import numpy as np

from fbench.datasets.city.camera import surfaces as looks
from fbench.datasets.city.camera.samples import HitArrays, Samples
from fbench.datasets.city.camera.sky import DAYLIGHT_LUX, Light, Rgb, plain_sky, sky
from fbench.datasets.city.camera.surfaces import EMITS, GLOSS, RETRO, TEXTURES, WETTABLE, Grid, Surfaces, cell_of
from fbench.datasets.city.instant import EGO, MISS, BodyStates
from fbench.datasets.city.mesh import Actor
from fbench.replay.data.arrays import Array, Float32, Float64
from fbench.replay.data.boxes import VEHICLES
from fbench.replay.geometry.kernels import kernel, kernel_part

_STREET_CD, _STREET_REACH_M = 1_800.0, 20.0  # Some 25 lx below a lamp of 8 m
_BEAM_CD, _BEAM_REACH_M = 14_000.0, 50.0
"""A low beam at its brightest, of two lamps together; UN R112 has 10,000 to 20,000 cd a lamp below the cut-off."""
_BEAM_HEIGHT_M = 0.7
_CONE_END = 0.2  # Cosine of the angle from below at which the cone of street lamps ends
_WIDEST = 0.75  # Tangent of the angle to the side at which beams end
_BEAM_DISC_M = 0.5 * _BEAM_REACH_M * (1 + _WIDEST * _WIDEST)
"""Radius of the disc around a beam, whose middle is as far ahead of the lamps."""
_AT_WIDEST = math.exp(-6 * _WIDEST * _WIDEST)


class Lamps(NamedTuple):
    """L lamps."""

    position_m: Float64  # (L, 3) in the world
    heading: Float64  # (L, 2) unit vectors where a beam goes; 0 for street lamps, which shine downwards
    near: Grid


def lamps_of(actors: tuple[Actor, ...], states: BodyStates, street_lamps_m: Float64, light: Light) -> Lamps:
    """Return what shines at an instant: nothing by day."""
    street = street_lamps_m if light.is_dark else np.zeros((0, 3))
    drives = [a.body.label in VEHICLES and not a.parked for a in actors]
    cars = np.flatnonzero(np.array(drives, bool)) if light.is_dark else np.zeros(0, np.int64)
    length = np.array([actors[i].body.size_lwh_m[0] for i in cars])
    heading = np.stack([np.cos(states.yaw_rad[cars]), np.sin(states.yaw_rad[cars])], axis=1)
    front = np.column_stack([states.position_m[cars, :2] + heading * (length / 2)[:, None],
                             states.position_m[cars, 2] + _BEAM_HEIGHT_M])  # fmt: skip
    position = np.concatenate([street, front])
    middle = position[:, :2] + np.concatenate([np.zeros((len(street), 2)), heading * _BEAM_DISC_M])
    radius = np.repeat([_STREET_REACH_M, _BEAM_DISC_M], [len(street), len(cars)])
    ego = states.position_m[EGO]
    near = looks.grid_around(float(ego[0]), float(ego[1]), middle, radius)
    return Lamps(position, np.concatenate([np.zeros((len(street), 2)), heading]), near)


@kernel
def add_lamplight(light_on: Array, hits: HitArrays, origin: Array, lamps: Lamps) -> None:
    """Add the illuminance by lamps to that of all hits (N, 3), in units of daylight."""
    range_m, body, direction, normal = hits.range_m, hits.body, hits.direction, hits.normal
    position, heading, start, items = lamps.position_m, lamps.heading, lamps.near.start, lamps.near.items
    x_m, y_m = lamps.near.x_m, lamps.near.y_m
    for i in range(len(body)):
        if body[i] == MISS:
            continue
        r = float(range_m[i])
        x, y, z = origin[0] + r * direction[i, 0], origin[1] + r * direction[i, 1], origin[2] + r * direction[i, 2]
        nx, ny, nz = float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2])
        cell, red, green, blue = cell_of(x_m, y_m, x, y), 0.0, 0.0, 0.0
        for k in range(start[cell], start[cell + 1] if cell >= 0 else start[cell]):
            n = items[k]
            dx, dy, dz = position[n, 0] - x, position[n, 1] - y, position[n, 2] - z
            facing, distance2 = dx * nx + dy * ny + dz * nz, dx * dx + dy * dy + dz * dz + 0.05
            if facing <= 0:
                continue
            hx, hy = heading[n, 0], heading[n, 1]
            if hx == 0 and hy == 0:
                level = _street(dz, distance2) * facing
                red, green, blue = red + 1.25 * level, green + 0.95 * level, blue + 0.58 * level
            else:
                level = _beam(dx, dy, dz, hx, hy, distance2) * facing
                red, green, blue = red + level, green + 0.97 * level, blue + 0.88 * level
        light_on[i, 0] += red
        light_on[i, 1] += green
        light_on[i, 2] += blue


@kernel_part
def _street(dz: float, distance2: float) -> float:
    """Illuminance by a street lamp `dz` above, divided by its distance squared, of a plane at a right angle to the
    vector towards it: with a cone that ends at some 75 degrees, and no step at its reach.
    """
    if dz <= 0 or dz * dz <= _CONE_END * _CONE_END * distance2 or distance2 >= _STREET_REACH_M * _STREET_REACH_M:
        return 0.0
    distance = math.sqrt(distance2)
    cone = min(1.0, (dz / distance - _CONE_END) / 0.25)
    end = min(1.0, 4 * (1 - distance / _STREET_REACH_M))
    return float(_STREET_CD / DAYLIGHT_LUX * cone * end / (distance2 * distance))


@kernel_part
def _beam(dx: float, dy: float, dz: float, hx: float, hy: float, distance2: float) -> float:
    """The same of low beams from which a point is seen at (dx, dy, dz): a cut-off 1 % below the horizon, little light
    far below it, so that the road is lit evenly, and wide to the sides.
    """
    ahead = -(dx * hx + dy * hy)
    side = dx * hy - dy * hx
    if ahead <= 0.3 or abs(side) >= _WIDEST * ahead or ahead >= _BEAM_REACH_M:
        return 0.0
    aside, below = side / ahead, dz / ahead
    over = 0.02 + 0.98 * min(1.0, max(0.0, (below + 0.004) / 0.018))
    end = min(1.0, 4 * (1 - ahead / _BEAM_REACH_M))
    shape = (math.exp(-6 * aside * aside) - _AT_WIDEST) * math.exp(-7 * max(below, 0.0))
    return float(_BEAM_CD / DAYLIGHT_LUX * over * shape * end / (distance2 * math.sqrt(distance2)))


GROUND = 0.16  # Typical albedo of the ground, which lights what hangs over it
_SPILL = 0.4 / 50_000  # Illuminance by a lit street from all around, by night


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


@kernel_part
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


_TABLE: Float64 = np.column_stack([GLOSS, RETRO, WETTABLE])
_WET_DARKER, _WET_GLOSS = 0.5, 0.02
"""How much darker wet ground is, and what it mirrors at normal incidence, as water does."""
_BRIGHTEST = 60.0  # In the image, white being 1: brighter lamps are no brighter
_HUE_KEPT = 6.0
"""Lamps brighter than this keep their color: red lights aren't white, as sensors with a wide range show them."""


class Scene(NamedTuple):
    """What surfaces are shaded with."""

    light: Light
    surfaces: Surfaces
    lamps: Lamps
    pixel_rad: float  # What a pixel in the middle of the image covers
    salt: int  # Of clouds


def radiances(samples: Samples, scene: Scene, mirror: Float32) -> Float32:
    """Return how bright (N, 3) samples are in the image, linear; white is 1. `mirror` (N, 4) is what wet ground
    mirrors, in the same unit, and whether that is known; (0, 4): nowhere.
    """
    hits, origin = samples.arrays, samples.rays.origin_m[0]
    albedo, shine = looks.colors(scene.surfaces, hits, EMITS)
    factor = looks.patterns(hits, origin, scene.surfaces.place, scene.pixel_rad, TEXTURES)
    light_on = daylight(hits, origin, scene.light, scene.surfaces)
    if scene.light.is_dark:
        add_lamplight(light_on, hits, origin, scene.lamps)
    ego = scene.surfaces.place[0]
    return _radiances(hits, albedo, shine, factor, light_on, mirror, scene.light, scene.salt, _TABLE, ego)


@kernel
def _radiances(
    hits: HitArrays, albedo: Array, shine: Array, factor: Array, light_on: Array, mirror: Float32,
    light: Light, salt: int, table: Array, ego: Array,
) -> Float32:  # fmt: skip
    range_m, body, direction, normal = hits.range_m, hits.body, hits.direction, hits.normal
    material, lit = hits.material, hits.lit
    result = np.empty((len(body), 3), np.float32)
    for i in range(len(body)):
        x, y, z = float(direction[i, 0]), float(direction[i, 1]), float(direction[i, 2])
        if body[i] == MISS:
            color = sky(light, x, y, z, salt)
        else:
            m, r, n = material[i], float(range_m[i]), (float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2]))
            wet = light.wet * table[m, 2] * max(0.0, n[2])
            own = float(shine[i])
            if light.is_dark:
                own += table[m, 1] * _retroreflection(r * (x * ego[3] + y * ego[4]), r * (y * ego[3] - x * ego[4]))
            level = factor[i] * (1 - _WET_DARKER * wet)
            color = (albedo[i, 0] * (light_on[i, 0] * level + own), albedo[i, 1] * (light_on[i, 1] * level + own),
                     albedo[i, 2] * (light_on[i, 2] * level + own))  # fmt: skip
            gloss = max(table[m, 0], _WET_GLOSS * wet)
            if gloss > 0 and shine[i] == 0:
                share, back = _gloss(light, gloss, wet, (x, y, z), n, lit[i])
                if wet > 0 and len(mirror) and mirror[i, 3] > 0:
                    scale = 1 / light.exposure
                    back = (mirror[i, 0] * scale, mirror[i, 1] * scale, mirror[i, 2] * scale)
                color = _blend(color, back, share)
            color = _blend(light.airlight, color, math.exp(-light.extinction_per_m * r))
        most = max(color[0], color[1], color[2]) * light.exposure
        for c in range(3):
            level = color[c] * light.exposure
            if most > _HUE_KEPT and level < most:
                level *= 1 - (1 - _HUE_KEPT / most) * (1 - (level / most) ** 2)
            result[i, c] = min(_BRIGHTEST, level)
    return result


@kernel_part
def _blend(a: Rgb, b: Rgb, share: float) -> Rgb:
    return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])


@kernel_part
def _gloss(light: Light, gloss: float, wet: float, ray: Rgb, n: Rgb, lit: bool) -> tuple[float, Rgb]:
    """Return which share a smooth surface mirrors (Schlick), and what: sky, houses near the horizon, the road below it;
    and the sun. Wet ground is rough.
    """
    facing = max(0.02, -(ray[0] * n[0] + ray[1] * n[1] + ray[2] * n[2]))
    share = gloss + (1 - gloss) * (1 - facing) ** 5 * (0.8 if wet == 0 else 0.6 * wet)
    x, y, z = ray[0] + 2 * facing * n[0], ray[1] + 2 * facing * n[1], ray[2] + 2 * facing * n[2]
    open_sky = min(1.0, max(0.0, (z + 0.02) / 0.3))
    ground = (light.ambient[1] + light.direct[1] * max(0.0, light.sun[2])) * GROUND * 0.8
    red, green, blue = _blend((ground, ground, ground), plain_sky(light, x, y, z), open_sky)
    toward = x * light.sun[0] + y * light.sun[1] + z * light.sun[2]
    shine = 25.0 * ((toward - 0.97) / 0.03) ** 6 if lit and toward > 0.97 else 0.0
    return share, (red + shine * light.direct[0], green + shine * light.direct[1], blue + shine * light.direct[2])


@kernel_part
def _retroreflection(ahead_m: float, aside_m: float) -> float:
    """Luminance with which reflectors send back the own headlights."""
    if ahead_m < 1 or abs(aside_m) > ahead_m:
        return 0.0
    return float(0.0007 * (1 - (aside_m / ahead_m) ** 2) ** 3 / (1 + (ahead_m / 15) ** 2))
