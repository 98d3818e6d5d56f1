"""Reflections on wet ground: one ray for every four pixels, blurred by the roughness of the ground."""

import math

import numpy as np

from fbench.datasets.city.camera.develop import mean_across
from fbench.datasets.city.camera.samples import HitArrays, Samples
from fbench.datasets.city.camera.sky import hashed
from fbench.datasets.city.camera.surfaces import WETTABLE
from fbench.datasets.city.motion import BodyStates
from fbench.datasets.city.rays.hits import MISS, Hits, RayCaster, Rays
from fbench.replay.data.arrays import Float32, Float64, Int64
from fbench.replay.geometry.kernels import kernel

NOTHING = np.zeros((0, 4), np.float32)
"""What dry ground mirrors."""
_RANGE_M = 200.0
_SLOPE = 0.035
"""By how much the slope of the film of water differs from place to place, chosen by eye."""
_PLACES_PER_M = 60.0
_BRIGHTEST = 4.0
_ASIDE_PX, _UPRIGHT_PX = 1, 5
"""How far mirrored light is spread twice, in pixels of half resolution: rough ground draws mirror images out."""
_LEAST = 1e-3


def mirrored_samples(
    caster: RayCaster, states: BodyStates, samples: Samples, width: int
) -> tuple[Samples, Int64] | None:
    """Return what every other wet pixel of every other row of an image mirrors, and which pixels (M,); or nothing.

    It is told as if it were seen from the camera through the ground.
    """
    origin = samples.rays.origin_m[0]
    index, start, direction = _reflected(samples.arrays, origin, WETTABLE, width)
    if not len(index):
        return None
    found = caster.cast(Rays(start, direction, _RANGE_M), states)
    seen, range_m = _as_seen(origin, start, direction, found.range_m)
    hits = Hits(range_m, found.body, found.triangle, found.normal, ())
    dark = np.zeros(len(index), bool)
    rays = Rays(samples.rays.origin_m, seen, samples.rays.range_m)
    return Samples(rays, hits, caster.material(found, states), found.normal, dark), index


def spread_mirrored(linear: Float32, index: Int64, size_wh: tuple[int, int]) -> Float32:
    """Spread mirrored light (M, 3) of pixels (M,) over the image: (N, 4), the last 1 where there is any."""
    width, height = size_wh
    small = _halved(linear, index, width, height)
    for _ in range(2):
        small = mean_across(mean_across(small, _ASIDE_PX), _UPRIGHT_PX)
    return _doubled(small, width, height)


@kernel
def _reflected(hits: HitArrays, origin: Float64, wettable: Float64, width: int) -> tuple[Int64, Float64, Float32]:
    body, normal, direction, material, range_m = hits.body, hits.normal, hits.direction, hits.material, hits.range_m
    most = ((len(body) // width + 1) // 2) * ((width + 1) // 2)
    index, num = np.empty(most, np.int64), 0
    start, away = np.empty((most, 3)), np.empty((most, 3), np.float32)
    for i in range(len(body)):
        if i % 2 or (i // width) % 2 or body[i] == MISS or normal[i, 2] < 0.9 or wettable[material[i]] == 0:
            continue
        r = float(range_m[i])
        for axis in range(3):
            start[num, axis] = origin[axis] + r * direction[i, axis] + 0.01 * normal[i, axis]
        u, v = math.floor(start[num, 0] * _PLACES_PER_M), math.floor(start[num, 1] * _PLACES_PER_M)
        nx, ny = _SLOPE * hashed(int(u), int(v), 5), _SLOPE * hashed(int(u), int(v), 6)
        dx, dy, dz = float(direction[i, 0]), float(direction[i, 1]), float(direction[i, 2])
        along = 2 * (dx * nx + dy * ny + dz) / (1 + nx * nx + ny * ny)
        x, y, z = dx - along * nx, dy - along * ny, max(dz - along, 0.003)
        length = math.sqrt(x * x + y * y + z * z)
        away[num, 0], away[num, 1], away[num, 2] = x / length, y / length, z / length
        index[num] = i
        num += 1
    return index[:num], start[:num], away[:num]


@kernel
def _as_seen(origin: Float64, start: Float64, direction: Float32, range_m: Float32) -> tuple[Float32, Float32]:
    """Directions (M, 3) and ranges (M,) from the camera to what reflected rays hit; the sky is where they go."""
    seen, far = direction.copy(), range_m.copy()
    for k in range(len(range_m)):
        if range_m[k] < np.inf:
            x = start[k, 0] + range_m[k] * direction[k, 0] - origin[0]
            y = start[k, 1] + range_m[k] * direction[k, 1] - origin[1]
            z = start[k, 2] + range_m[k] * direction[k, 2] - origin[2]
            length = math.sqrt(x * x + y * y + z * z)
            seen[k, 0], seen[k, 1], seen[k, 2], far[k] = x / length, y / length, z / length, length
    return seen, far


@kernel
def _halved(linear: Float32, index: Int64, width: int, height: int) -> Float32:
    """Return mirrored light at half the image's width and height, (h, w, 4); the last 1 where there is any."""
    small = np.zeros(((height + 1) // 2, (width + 1) // 2, 4), np.float32)
    for k in range(len(index)):
        v, u = index[k] // width // 2, index[k] % width // 2
        for c in range(3):
            small[v, u, c] = min(_BRIGHTEST, linear[k, c])
        small[v, u, 3] = 1
    return small


@kernel
def _doubled(small: Float32, width: int, height: int) -> Float32:
    result = np.zeros((height * width, 4), np.float32)
    for v in range(height):
        i, b = _between(v, small.shape[0])
        for u in range(width):
            j, a = _between(u, small.shape[1])
            weight = _mixed(small, i, j, a, b, 3)
            if weight > _LEAST:
                for c in range(3):
                    result[v * width + u, c] = _mixed(small, i, j, a, b, c) / weight
                result[v * width + u, 3] = 1
    return result


@kernel
def _between(pixel: int, num: int) -> tuple[int, float]:
    """Return which of `num` larger pixels is before a pixel, with one behind it, and how far it is from there on."""
    place = min(0.5 * pixel, num - 1.0)
    first = min(int(place), num - 2)
    return first, place - first


@kernel
def _mixed(image: Float32, i: int, j: int, a: float, b: float, c: int) -> float:
    upper = image[i, j, c] * (1 - a) + image[i, j + 1, c] * a
    lower = image[i + 1, j, c] * (1 - a) + image[i + 1, j + 1, c] * a
    return float(upper * (1 - b) + lower * b)
