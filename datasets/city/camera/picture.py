"""Images of the city with reflections on wet ground, and the truth of every pixel."""

import math
from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.camera.develop import add_streaks, develop, mean_across
from fbench.datasets.city.camera.samples import Eye, HitArrays, Samples, first_samples, more_samples
from fbench.datasets.city.camera.shade import Scene, lamps_of, radiances
from fbench.datasets.city.camera.sky import hash_noise, light_of
from fbench.datasets.city.camera.surfaces import WETTABLE, surfaces_of
from fbench.datasets.city.instant import MISS, BodyStates, Hits, Rays
from fbench.datasets.city.rays.caster import EmbreeCaster, Instant
from fbench.datasets.city.rig import CameraSpec
from fbench.replay.conditions.generators import generator
from fbench.replay.data.arrays import Array, Bool, Float32, Float64, Int64
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image
from fbench.replay.geometry.kernels import kernel, kernel_part

NOTHING = np.zeros((0, 4), np.float32)  # What dry ground mirrors
_RANGE_M, _BRIGHTEST, _LEAST = 200.0, 4.0, 1e-3
_SLOPE, _PLACES_PER_M = 0.035, 60.0
"""By how much the slope of the film of water differs from place to place, chosen by eye."""
_ASIDE_PX, _UPRIGHT_PX = 1, 5
"""How far mirrored light is spread twice, in pixels of half resolution: rough ground draws mirror images out."""


def mirror_samples(
    caster: EmbreeCaster, states: BodyStates, samples: Samples, width: int
) -> tuple[Samples, Int64] | None:
    """Return what every other wet pixel of every other row of an image mirrors, and which pixels (M,); or nothing. It
    is given as if it were seen from the camera through the ground.
    """
    origin = samples.rays.origin_m[0]
    index, start, direction = _reflect(samples.arrays, origin, WETTABLE, width)
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
    small = _halve(linear, index, width, height)
    for _ in range(2):
        small = mean_across(mean_across(small, _ASIDE_PX), _UPRIGHT_PX)
    return _double(small, width, height)


@kernel
def _reflect(hits: HitArrays, origin: Float64, wettable: Float64, width: int) -> tuple[Int64, Float64, Float32]:
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
        nx, ny = _SLOPE * hash_noise(int(u), int(v), 5), _SLOPE * hash_noise(int(u), int(v), 6)
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
def _halve(linear: Float32, index: Int64, width: int, height: int) -> Float32:
    """Return mirrored light at half the image's width and height, (h, w, 4); the last 1 where there is any."""
    small = np.zeros(((height + 1) // 2, (width + 1) // 2, 4), np.float32)
    for k in range(len(index)):
        v, u = index[k] // width // 2, index[k] % width // 2
        for c in range(3):
            small[v, u, c] = min(_BRIGHTEST, linear[k, c])
        small[v, u, 3] = 1
    return small


@kernel
def _double(small: Float32, width: int, height: int) -> Float32:
    result = np.zeros((height * width, 4), np.float32)
    for v in range(height):
        i, b = _between(v, small.shape[0])
        for u in range(width):
            j, a = _between(u, small.shape[1])
            weight = _mix(small, i, j, a, b, 3)
            if weight > _LEAST:
                for c in range(3):
                    result[v * width + u, c] = _mix(small, i, j, a, b, c) / weight
                result[v * width + u, 3] = 1
    return result


@kernel_part
def _between(pixel: int, num: int) -> tuple[int, float]:
    """Return which of `num` larger pixels is before a pixel, with one behind it, and how far it is from there on."""
    place = min(0.5 * pixel, num - 1.0)
    first = min(int(place), num - 2)
    return first, place - first


@kernel_part
def _mix(image: Float32, i: int, j: int, a: float, b: float, c: int) -> float:
    upper = image[i, j, c] * (1 - a) + image[i, j + 1, c] * a
    lower = image[i + 1, j, c] * (1 - a) + image[i + 1, j + 1, c] * a
    return float(upper * (1 - b) + lower * b)


_APART_PX = 1 / 3
"""How far from an edge pixel's center its two further rays go, in both directions: the three are evenly spread."""
_CONTRAST, _FAINT = 0.06, 0.01
"""Share by which the light on both sides of an edge must differ, and by how much of white, for it to be seen."""
_SAME_WAY, _APART_M, _APART = 0.93, 0.05, 0.003
"""Cosine between normals of one surface; how far, and how far a meter of range, hits lie off its plane."""


def jitter(uv: Float32, pixels: Int64, width: int) -> Float32:
    """Places (2 E, 2) of the further rays: those of the first pixel, of the second ...; on one diagonal or, in every
    other pixel, the other, so that no direction of edges is worse than others.
    """
    up = np.where((pixels // width + pixels % width) % 2 == 0, _APART_PX, -_APART_PX).astype(np.float32)
    right = np.full_like(up, _APART_PX)
    move = np.stack([right, up, -right, -up], axis=1).reshape(-1, 2, 2)
    return (uv[pixels][:, None] + move).reshape(-1, 2)


@kernel
def _edges(hits: HitArrays, linear: Float32, width: int) -> Bool:
    """Return which pixels (N,) don't show the same surface, in the same light, as a neighbor below, above or beside,
    and differ from it in their light (N, 3) so that one can see it.
    """
    body, triangle, material, lit = hits.body, hits.triangle, hits.material, hits.lit
    range_m, normal, direction = hits.range_m, hits.normal, hits.direction
    edges = np.zeros(len(body), np.bool_)
    for i in range(len(body)):
        for j in (i + 1, i + width):
            if (j == i + 1 and j % width == 0) or j >= len(body) or not _contrasts(linear, i, j):
                continue
            differs = body[i] != body[j] or material[i] != material[j] or lit[i] != lit[j]
            if differs or (triangle[i] != triangle[j] and _bends(range_m, normal, direction, i, j)):
                edges[i] = edges[j] = True
    return edges


@kernel_part
def _bends(range_m: Array, normal: Array, direction: Array, i: int, j: int) -> bool:
    """Return whether two hits don't lie in one plane."""
    turn, apart = 0.0, 0.0
    for axis in range(3):
        turn += normal[i, axis] * normal[j, axis]
        apart += normal[i, axis] * (direction[j, axis] * range_m[j] - direction[i, axis] * range_m[i])
    return turn < _SAME_WAY or abs(apart) > _APART_M + _APART * range_m[i]


@kernel_part
def _contrasts(linear: Float32, i: int, j: int) -> bool:
    for c in range(3):
        a, b = linear[i, c], linear[j, c]
        if abs(a - b) > _CONTRAST * min(a, b) + _FAINT:
            return True
    return False


@dataclass(frozen=True, eq=False)
class Picture:
    """One image and what each pixel shows; pixel (u, v) is at [v, u]."""

    image: Image  # As JPEG
    rgb: Array  # (H, W, 3) uint8, before it was encoded
    depth_m: Float32  # (H, W) Z in camera coordinates; infinite for the sky
    body: Array  # (H, W) int32 index of the actor, `STATIC` or `MISS` (the sky)
    material: Array  # (H, W) uint8 index into `MATERIALS`; 255 for the sky
    normal: Float32  # (H, W, 3) in the world, towards the camera; 0 for the sky
    alone: tuple[tuple[int, Int64], ...]  # As `Hits.alone`, with pixels v * W + u


def picture(now: Instant, spec: CameraSpec) -> Picture:
    """Take an image: one ray through the center of each pixel, more where edges need it. The camera's coordinates are x
    right, y down, z forward. The noise is its own; the rest is the same for all cameras.
    """
    light, model = light_of(now.weather), spec.model()
    caster, states, eye = now.caster, now.states, Eye(model, now.world_T_sensor)
    lamps = lamps_of(caster.actors, states, now.street_lamps_m, light)
    salt = int(generator(now.seed, "camera", "clouds").integers(1 << 30))
    scene = Scene(light, surfaces_of(caster, states, light), lamps, 1 / float(model.K[0, 0]), salt)
    uv = eye.pixels()
    samples = first_samples(caster, states, eye, uv, light)
    width, height = spec.size_wh
    mirror = NOTHING  # what wet ground mirrors
    if light.wet > 0 and (reflected := mirror_samples(caster, states, samples, width)) is not None:
        mirror = spread_mirrored(radiances(reflected[0], scene, NOTHING), reflected[1], spec.size_wh)
    linear = radiances(samples, scene, mirror)
    pixels = np.flatnonzero(_edges(samples.arrays, linear, width))
    if len(pixels):
        more = more_samples(caster, states, eye, jitter(uv, pixels, width), light, samples, pixels)
        there = mirror[np.repeat(pixels, len(more.lit) // len(pixels))] if len(mirror) else mirror
        others, total = radiances(more, scene, there).reshape(len(pixels), -1, 3), linear[pixels]
        for k in range(others.shape[1]):
            total += others[:, k]
        linear[pixels] = total / np.float32(1 + others.shape[1])
    linear = linear.reshape(height, width, 3)
    add_streaks(linear, now, model, light)
    rgb = develop(linear, spec, light, now.generator("camera"))
    data = encode_jpeg(rgb[..., ::-1], spec.jpeg_quality)
    image = Image(now.sensor, now.stamp_ns, now.log_ns, data, "jpeg", spec.size_wh)
    hits, depth_m = samples.hits, eye.depth_m(uv, samples.hits.range_m)
    return Picture(
        image, rgb, depth_m.reshape(height, width), hits.body.reshape(height, width),
        samples.material.reshape(height, width), hits.normal.reshape(height, width, 3), hits.alone,
    )  # fmt: skip
