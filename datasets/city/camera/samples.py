"""Rays through an image, what they hit, and whether the sun shines there."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fbench.datasets.city.camera.light import Light
from fbench.datasets.city.motion import BodyStates
from fbench.datasets.city.rays.hits import MISS, Hits, RayCaster, Rays
from fbench.replay.arrays import Array, Bool, Float32, Float64, Int64
from fbench.replay.data import CameraModel
from fbench.replay.kernels import kernel

RANGE_M = 1_500.0
_SHADOW_RANGE_M = 250.0


@dataclass(frozen=True, eq=False)
class Eye:
    """A camera in the world."""

    model: CameraModel
    world_T_camera: Float64
    """(4, 4)"""

    def pixels(self) -> Float32:
        """Centres (N, 2) of all pixels, row by row."""
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

    direction: Float32
    """(N, 3)"""
    range_m: Float32
    body: Array
    triangle: Array
    normal: Float32
    """(N, 3)"""
    material: Array
    lit: Bool


@dataclass(frozen=True, eq=False)
class Samples:
    """N rays and what they hit."""

    rays: Rays
    hits: Hits
    material: Array
    """(N,) uint8."""
    lit: Bool
    """(N,) whether the sun shines there."""

    @property
    def arrays(self) -> HitArrays:
        """What a kernel needs of them."""
        hits = self.hits
        return HitArrays(self.rays.direction, hits.range_m, hits.body, hits.triangle, hits.normal, self.material,
                         self.lit)  # fmt: skip


def sample(caster: RayCaster, states: BodyStates, eye: Eye, uv: Float32, light: Light) -> Samples:
    """Look through pixels (N, 2)."""
    rays = Rays(eye.world_T_camera[None, :3, 3], eye.directions(uv), RANGE_M)
    hits = caster.cast(rays, states)
    return Samples(rays, hits, caster.material(hits, states), _sunlit(caster, states, rays, hits, light))


def _sunlit(caster: RayCaster, states: BodyStates, rays: Rays, hits: Hits, light: Light) -> Bool:
    lit = np.zeros(len(hits.body), bool)
    if light.direct[1] < 0.02 * light.ambient[1]:
        return lit
    index, start = _facing(rays.origin_m[0], rays.direction, hits.range_m, hits.body, hits.normal, np.array(light.sun))
    if len(index):
        toward = np.broadcast_to(np.array(light.sun, np.float32), (len(index), 3))
        lit[index] = ~caster.blocked(Rays(start, np.ascontiguousarray(toward), _SHADOW_RANGE_M), states)
    return lit


@kernel
def _facing(
    origin: Array, direction: Array, range_m: Array, body: Array, normal: Array,
    sun: Array,
) -> tuple[Int64, Float64]:  # fmt: skip
    """Indices of hits that face the sun, and points just above them."""
    index, start = np.empty(len(body), np.int64), np.empty((len(body), 3))
    num = 0
    for i in range(len(body)):
        if body[i] == MISS or normal[i, 0] * sun[0] + normal[i, 1] * sun[1] + normal[i, 2] * sun[2] <= 0:
            continue
        lift = 0.01 + 1e-4 * range_m[i]
        for axis in range(3):
            start[num, axis] = origin[axis] + direction[i, axis] * np.float64(range_m[i]) + lift * normal[i, axis]
        index[num] = i
        num += 1
    return index[:num], start[:num]


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
