"""Rays and what they hit."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fbench.datasets.city.mesh import Actor, Mesh
from fbench.datasets.city.motion import BodyStates
from fbench.replay.data.arrays import Array, Bool, Float32, Float64, Int64, freeze_fields

STATIC, MISS = -1, -2
"""What a ray hit that hit no actor: the static world, or nothing within its range."""


@dataclass(frozen=True, eq=False)
class Rays:
    """N rays in world coordinates."""

    origin_m: Float64
    """(N, 3), or (1, 3) for all of them."""
    direction: Float32
    """(N, 3) unit vectors."""
    range_m: float
    """How far they go."""
    offset_s: Float64 | None = None
    """(N,) how long after the states' instant each is shot; bodies move on at constant velocity and turn rate."""

    def __post_init__(self) -> None:
        # kernels are compiled for contiguous arrays only
        object.__setattr__(self, "origin_m", np.ascontiguousarray(self.origin_m))
        object.__setattr__(self, "direction", np.ascontiguousarray(self.direction))
        freeze_fields(self, origin_m=("f8", ("M", 3)), direction=("f4", ("N", 3)), offset_s=("f8", ("N",)))


@dataclass(frozen=True, eq=False)
class Hits:
    """What N rays hit first."""

    range_m: Float32
    """(N,), infinite where nothing was hit."""
    body: Array
    """(N,) int32 index of the actor, `STATIC` or `MISS`."""
    triangle: Array
    """(N,) int32 of the mesh that was hit (of the phase in which the actor is), -1 where nothing was."""
    normal: Float32
    """(N, 3) unit vectors in the world, towards the side where the ray comes from; 0 where nothing was hit."""
    alone: tuple[tuple[int, Int64], ...]
    """For every actor that a ray would hit if it were alone in the world: its index and those of these rays, both
    ascending. The share of them that `body` confirms is what is visible of it."""


class RayCaster(Protocol):
    """The world at any instant, as rays see it. Never changes, so threads can share it."""

    @property
    def static(self) -> Mesh:
        """All that never moves."""
        ...

    @property
    def actors(self) -> tuple[Actor, ...]:
        """All bodies; the first, the ego vehicle, is never hit."""
        ...

    def cast(self, rays: Rays, states: BodyStates) -> Hits:
        """Follow rays to the first surface."""
        ...

    def blocked(self, rays: Rays, states: BodyStates) -> Bool:
        """Tell of which rays (N,) something is in the way within their range: shadows."""
        ...

    def material(self, hits: Hits, states: BodyStates) -> Array:
        """Indices (N,) uint8 into `MATERIALS` of what was hit; 255 where nothing was."""
        ...

    def smoothed(self, rays: Rays, hits: Hits, states: BodyStates) -> Float32:
        """Normals (N, 3) like `Hits.normal`, as if bodies were round where their triangles meet at small angles: for
        shading. All rays have one origin and no offset.
        """
        ...
