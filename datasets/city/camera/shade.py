"""How bright what rays hit looks: light, surface, air."""

import math
from typing import NamedTuple

import numpy as np

from fbench.datasets.city.camera.lamps import Lamps, add_lamplight
from fbench.datasets.city.camera.light import Light, Rgb
from fbench.datasets.city.camera.outdoors import GROUND, daylight
from fbench.datasets.city.camera.samples import HitArrays, Samples
from fbench.datasets.city.camera.sky import plain_sky, sky
from fbench.datasets.city.camera.surfaces import EMITS, GLOSS, RETRO, WETTABLE, Surfaces, colors
from fbench.datasets.city.camera.textures import TEXTURES, patterns
from fbench.datasets.city.rays.hits import MISS
from fbench.replay.arrays import Array, Float32, Float64
from fbench.replay.kernels import kernel

_TABLE: Float64 = np.column_stack([GLOSS, RETRO, WETTABLE])
_WET_DARKER, _WET_GLOSS = 0.5, 0.02
"""How much darker wet ground is, and what it mirrors at normal incidence, as water does."""
_BRIGHTEST = 60.0
"""In the image, white being 1: brighter lamps are no brighter."""
_HUE_KEPT = 6.0
"""Lamps brighter than this keep their colour: red lights aren't white, as sensors with a wide range show them."""


class Scene(NamedTuple):
    """What surfaces are shaded with."""

    light: Light
    surfaces: Surfaces
    lamps: Lamps
    pixel_rad: float
    """What a pixel in the middle of the image covers."""
    salt: int
    """Of clouds."""


def radiances(samples: Samples, scene: Scene, mirror: Float32) -> Float32:
    """Return how bright (N, 3) samples are in the image, linear; white is 1.

    `mirror` (N, 4) is what wet ground mirrors, in the same unit, and whether that is known; (0, 4): nowhere.
    """
    hits, origin = samples.arrays, samples.rays.origin_m[0]
    albedo, shine = colors(scene.surfaces, hits, EMITS)
    factor = patterns(hits, origin, scene.surfaces.place, scene.pixel_rad, TEXTURES)
    light_on = daylight(hits, origin, scene.light, scene.surfaces)
    if scene.light.is_dark:
        add_lamplight(light_on, hits, origin, scene.lamps)
    return _radiances(
        hits, albedo, shine, factor, light_on, mirror, scene.light, scene.salt, _TABLE, scene.surfaces.place[0]
    )


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
                own += table[m, 1] * _returned(r * (x * ego[3] + y * ego[4]), r * (y * ego[3] - x * ego[4]))
            level = factor[i] * (1 - _WET_DARKER * wet)
            color = (albedo[i, 0] * (light_on[i, 0] * level + own), albedo[i, 1] * (light_on[i, 1] * level + own),
                     albedo[i, 2] * (light_on[i, 2] * level + own))  # fmt: skip
            gloss = max(table[m, 0], _WET_GLOSS * wet)
            if gloss > 0 and shine[i] == 0:
                share, back = _glossed(light, gloss, wet, (x, y, z), n, lit[i])
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


@kernel
def _blend(a: Rgb, b: Rgb, share: float) -> Rgb:
    return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])


@kernel
def _glossed(light: Light, gloss: float, wet: float, ray: Rgb, n: Rgb, lit: bool) -> tuple[float, Rgb]:
    """Return which share a smooth surface mirrors (Schlick), and what; wet ground is rough."""
    facing = max(0.02, -(ray[0] * n[0] + ray[1] * n[1] + ray[2] * n[2]))
    share = gloss + (1 - gloss) * (1 - facing) ** 5 * (0.8 if wet == 0 else 0.6 * wet)
    x, y, z = ray[0] + 2 * facing * n[0], ray[1] + 2 * facing * n[1], ray[2] + 2 * facing * n[2]
    return share, _mirrored(light, x, y, z, lit)


@kernel
def _returned(ahead_m: float, aside_m: float) -> float:
    """Luminance with which reflectors send back the own headlights."""
    if ahead_m < 1 or abs(aside_m) > ahead_m:
        return 0.0
    return float(0.0007 * (1 - (aside_m / ahead_m) ** 2) ** 3 / (1 + (ahead_m / 15) ** 2))


@kernel
def _mirrored(light: Light, x: float, y: float, z: float, lit: bool) -> Rgb:
    """What a smooth surface mirrors from a direction: sky, houses near the horizon, the road below it; and the sun."""
    open_sky = min(1.0, max(0.0, (z + 0.02) / 0.3))
    ground = (light.ambient[1] + light.direct[1] * max(0.0, light.sun[2])) * GROUND * 0.8
    red, green, blue = _blend((ground, ground, ground), plain_sky(light, x, y, z), open_sky)
    toward = x * light.sun[0] + y * light.sun[1] + z * light.sun[2]
    shine = 25.0 * ((toward - 0.97) / 0.03) ** 6 if lit and toward > 0.97 else 0.0
    return red + shine * light.direct[0], green + shine * light.direct[1], blue + shine * light.direct[2]
