"""Rays through an image, what they hit, and whether the sun shines there."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fbench.datasets.city.camera.light import Light
from fbench.datasets.city.camera.sunlight import sunlit_between, sunlit_pixels
from fbench.datasets.city.motion import BodyStates
from fbench.datasets.city.rays.hits import Hits, RayCaster, Rays
from fbench.replay.arrays import Array, Bool, Float32, Float64, Int64
from fbench.replay.data import CameraModel
from fbench.replay.kernels import kernel

RANGE_M = 1_500.0


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
    normal: Float32
    """(N, 3) for shading: round where bodies are."""
    lit: Bool
    """(N,) whether the sun shines there."""

    @property
    def arrays(self) -> HitArrays:
        """What a kernel needs of them."""
        hits = self.hits
        return HitArrays(self.rays.direction, hits.range_m, hits.body, hits.triangle, self.normal, self.material,
                         self.lit)  # fmt: skip


def first_samples(caster: RayCaster, states: BodyStates, eye: Eye, uv: Float32, light: Light) -> Samples:
    """Look through all pixels (N, 2), row by row."""
    rays = Rays(eye.world_T_camera[None, :3, 3], eye.directions(uv), RANGE_M)
    hits = caster.cast(rays, states)
    lit = sunlit_pixels(caster, states, rays, hits, light, eye.model.size_wh[0])
    return Samples(rays, hits, caster.material(hits, states), caster.smoothed(rays, hits, states), lit)


def more_samples(
    caster: RayCaster, states: BodyStates, eye: Eye, uv: Float32, light: Light, first: Samples, pixels: Int64
) -> Samples:
    """Look through further places (n E, 2), n in each of `pixels` (E,)."""
    rays = Rays(first.rays.origin_m, eye.directions(uv), RANGE_M)
    hits = caster.cast(rays, states)
    width = eye.model.size_wh[0]
    lit = sunlit_between(caster, states, rays, hits, light, first.hits, first.lit, pixels, width)
    return Samples(rays, hits, caster.material(hits, states), caster.smoothed(rays, hits, states), lit)


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
