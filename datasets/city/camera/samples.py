"""Rays through an image, what they hit, and whether the sun shines there."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fbench.datasets.city.camera.sky import Light
from fbench.datasets.city.instant import MISS, BodyStates, Hits, Rays
from fbench.datasets.city.rays.caster import EmbreeCaster
from fbench.replay.data.arrays import Array, Bool, Float32, Float64, Int64
from fbench.replay.data.rig import CameraModel
from fbench.replay.geometry.kernels import kernel

RANGE_M, _SUN_RANGE_M = 1_500.0, 250.0
_WEAK = 0.02  # Sunlight as a share of the sky's that nobody sees
_MOST_SAME = 2  # So many neighbors on the same triangle decide for a pixel, and one for a further ray
_NONE = np.zeros(0, np.int64)


def find_sunlit(
    caster: EmbreeCaster, states: BodyStates, rays: Rays, hits: Hits, light: Light, width: int,
    first: tuple[Hits, Bool, Int64] | None = None,
) -> Bool:  # fmt: skip
    """Return on which of the pixels (N,) of a whole image, row by row, the sun shines. Every other pixel is asked, like
    the white fields of a chessboard, and those between whose neighbors on the same triangle don't agree: what is missed
    is smaller than a pixel.

    With `first`, the hits of the image and where the sun shines on them, return it of further rays, as many of each of
    its pixels (E,): what lies on the same triangle as pixels around, all in the same light, has it too.
    """
    lit = np.zeros(len(hits.body), bool)
    if light.direct[1] < _WEAK * light.ambient[1]:
        return lit
    facing = _facing(hits.body, hits.normal, np.array(light.sun))
    if first is None:
        white = np.add.outer(np.arange(len(lit) // width), np.arange(width)).ravel() % 2 == 0
        _ask(caster, states, rays, hits, light, np.flatnonzero(facing & white), lit)
        first = hits, lit, _NONE
    image, image_lit, pixels = first
    unsure = _unsure(facing, hits.body, hits.triangle, lit, image.body, image.triangle, image_lit, pixels, width)
    _ask(caster, states, rays, hits, light, unsure, lit)
    return lit


def _ask(
    caster: EmbreeCaster, states: BodyStates, rays: Rays, hits: Hits, light: Light, index: Int64, lit: Bool
) -> None:
    """Write of some hits whether anything is between them and the sun."""
    if len(index):
        start = _just_above(rays.origin_m[0], rays.direction, hits.range_m, hits.normal, index)
        toward = np.repeat(np.array([light.sun], np.float32), len(index), axis=0)
        lit[index] = ~caster.is_blocked(Rays(start, toward, _SUN_RANGE_M), states)


@kernel
def _facing(body: Array, normal: Float32, sun: Float64) -> Bool:
    facing = np.zeros(len(body), np.bool_)
    for i in range(len(body)):
        toward = normal[i, 0] * sun[0] + normal[i, 1] * sun[1] + normal[i, 2] * sun[2]
        facing[i] = body[i] != MISS and toward > 0
    return facing


@kernel
def _unsure(
    facing: Bool, body: Array, triangle: Array, lit: Bool, first_body: Array, first_triangle: Array, first_lit: Bool,
    pixels: Int64, width: int,
) -> Int64:  # fmt: skip
    """Write what those around agree on; returns those where they don't: of the image, where there are no `pixels`, the
    black fields with their white neighbors; of further rays, all with the pixel that they are of and those around it.
    """
    index, num, each = np.empty(len(facing), np.int64), 0, len(facing) // max(1, len(pixels))
    of_image = len(pixels) == 0
    for k in range(len(facing)):
        i = k if of_image else pixels[k // each]
        if not facing[k] or (of_image and (i // width + i % width) % 2 == 0):
            continue
        same, bright = 0, 0
        for j in (i - width, i - 1, i, i + 1, i + width):
            other_row = (j == i - 1 and i % width == 0) or (j == i + 1 and j % width == 0)
            there = 0 <= j < len(first_body) and not other_row and not (of_image and j == i)
            if there and first_body[j] == body[k] and first_triangle[j] == triangle[k]:
                same += 1
                bright += first_lit[j]
        if same >= (_MOST_SAME if of_image else 1) and (bright == 0 or bright == same):
            lit[k] = bright > 0
        else:
            index[num] = k
            num += 1
    return index[:num]


@kernel
def _just_above(origin: Float64, direction: Float32, range_m: Float32, normal: Float32, index: Int64) -> Float64:
    """Points (M, 3) a little above some hits."""
    start = np.empty((len(index), 3))
    for n in range(len(index)):
        i = index[n]
        lift = 0.01 + 1e-4 * range_m[i]
        for axis in range(3):
            start[n, axis] = origin[axis] + direction[i, axis] * np.float64(range_m[i]) + lift * normal[i, axis]
    return start


@dataclass(frozen=True, eq=False)
class Eye:
    """A camera in the world."""

    model: CameraModel
    world_T_camera: Float64  # (4, 4)

    def pixels(self) -> Float32:
        """Centers (N, 2) of all pixels, row by row."""
        width, height = self.model.size_wh
        uv = np.empty((height, width, 2), np.float32)
        uv[..., 0], uv[..., 1] = np.arange(width), np.arange(height)[:, None]
        return uv.reshape(-1, 2)

    def depth_m(self, uv: Float32, range_m: Float32) -> Float32:
        """Z in camera coordinates (N,) of what is seen through pixels (N, 2) at a range (N,)."""
        K = self.model.K
        return _depths(uv, range_m, K[0, 0], K[1, 1], K[0, 2], K[1, 2])

    def directions(self, uv: Float32) -> Float32:
        """Unit vectors (N, 3) in the world of rays through pixels (N, 2)."""
        K = self.model.K
        return _directions(uv, K[0, 0], K[1, 1], K[0, 2], K[1, 2], np.ascontiguousarray(self.world_T_camera[:3, :3]))


class HitArrays(NamedTuple):
    """What N rays hit, for kernels."""

    direction: Float32  # (N, 3)
    range_m: Float32
    body: Array
    triangle: Array
    normal: Float32  # (N, 3)
    material: Array
    lit: Bool


@dataclass(frozen=True, eq=False)
class Samples:
    """N rays and what they hit."""

    rays: Rays
    hits: Hits
    material: Array  # (N,) uint8
    normal: Float32  # (N, 3) for shading: round where bodies are
    lit: Bool  # (N,) whether the sun shines there

    @property
    def arrays(self) -> HitArrays:
        """What a kernel needs of them."""
        hits = self.hits
        return HitArrays(self.rays.direction, hits.range_m, hits.body, hits.triangle, self.normal, self.material,
                         self.lit)  # fmt: skip


def first_samples(caster: EmbreeCaster, states: BodyStates, eye: Eye, uv: Float32, light: Light) -> Samples:
    """Look through all pixels (N, 2), row by row."""
    rays = Rays(eye.world_T_camera[None, :3, 3], eye.directions(uv), RANGE_M)
    hits = caster.cast(rays, states)
    lit = find_sunlit(caster, states, rays, hits, light, eye.model.size_wh[0])
    return Samples(rays, hits, caster.material(hits, states), caster.smooth_normals(rays, hits, states), lit)


def more_samples(
    caster: EmbreeCaster, states: BodyStates, eye: Eye, uv: Float32, light: Light, first: Samples, pixels: Int64
) -> Samples:
    """Look through further places (n E, 2), n in each of `pixels` (E,)."""
    rays = Rays(first.rays.origin_m, eye.directions(uv), RANGE_M)
    hits = caster.cast(rays, states)
    lit = find_sunlit(caster, states, rays, hits, light, eye.model.size_wh[0], (first.hits, first.lit, pixels))
    return Samples(rays, hits, caster.material(hits, states), caster.smooth_normals(rays, hits, states), lit)


@kernel
def _directions(uv: Array, fx: float, fy: float, cx: float, cy: float, rotation: Array) -> Float32:
    result = np.empty((len(uv), 3), np.float32)
    for i in range(len(uv)):
        x, y = (uv[i, 0] - cx) / fx, (uv[i, 1] - cy) / fy
        scale = 1 / math.sqrt(x * x + y * y + 1)
        for axis in range(3):
            result[i, axis] = scale * (rotation[axis, 0] * x + rotation[axis, 1] * y + rotation[axis, 2])
    return result


@kernel
def _depths(uv: Array, range_m: Array, fx: float, fy: float, cx: float, cy: float) -> Float32:
    result = np.empty(len(uv), np.float32)
    for i in range(len(uv)):
        x, y = (uv[i, 0] - cx) / fx, (uv[i, 1] - cy) / fy
        result[i] = range_m[i] / math.sqrt(x * x + y * y + 1)
    return result
