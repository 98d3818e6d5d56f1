"""The ray caster on Embree: the static world in one scene, each body's mesh in one of its own."""

import math

import numpy as np
from embreex.rtcore import EmbreeDevice

from fbench.datasets.city.mesh import Actor, Mesh, merged
from fbench.datasets.city.motion import EGO, BodyStates
from fbench.datasets.city.rays.culling import cones_of_blocks, merge_nearer, rays_at_body, starts_of_blocks
from fbench.datasets.city.rays.hits import MISS, STATIC, Hits, Rays
from fbench.datasets.city.rays.smooth import Scene, round_normals, rounding, unit_normals
from fbench.replay.data.arrays import Array, Bool, Float32, Float64, Int64
from fbench.replay.geometry.kernels import kernel


@kernel
def facing_normals(
    body: Array, triangle: Array, direction: Float32, offset_s: Float64, bodies: Float64, first: Int64,
    normals: Float32,
) -> Float32:  # fmt: skip
    """Return unit normals (N, 3) in the world, towards where rays come from; 0 for misses.

    `normals` are those of all meshes in their own coordinates, one mesh after the other; `first` (A,) is where the
    mesh of each body begins, and the static world's are the first. `bodies` (A, 8) as in `rays_at_body`.
    """
    facing = np.zeros((len(body), 3), np.float32)
    cos, sin = np.cos(bodies[:, 3]), np.sin(bodies[:, 3])
    for k in range(len(body)):
        i = body[k]
        if i < -1:
            continue
        n = normals[triangle[k] + (first[i] if i >= 0 else 0)]
        x, y, z = float(n[0]), float(n[1]), float(n[2])
        if i >= 0:
            c, s = cos[i], sin[i]
            if len(offset_s):
                yaw = bodies[i, 3] + bodies[i, 7] * offset_s[k]
                c, s = math.cos(yaw), math.sin(yaw)
            x, y = c * x - s * y, s * x + c * y
        sign = -1.0 if x * direction[k, 0] + y * direction[k, 1] + z * direction[k, 2] > 0 else 1.0
        facing[k, 0], facing[k, 1], facing[k, 2] = sign * x, sign * y, sign * z
    return facing


_NO_MATERIAL = 255
_NO_OFFSETS: Float64 = np.zeros(0)
_NO_OFFSETS.setflags(write=False)  # like those of rays: kernels are compiled for one kind of array only


class EmbreeCaster:
    """Casts rays at a static world and at actors wherever they are. Never changes, so threads can share it.

    Bodies are met in their own coordinates, so that distance from the world's origin costs them no precision.
    """

    def __init__(self, static: Mesh, actors: tuple[Actor, ...]) -> None:
        self._static, self._actors = static, actors
        phases = {mesh: None for actor in actors for mesh in actor.body.phases}
        device = EmbreeDevice()
        self._scenes = {mesh: Scene(mesh, device) for mesh in phases}
        self._world = Scene(static, device)
        meshes = (static, *phases)
        starts = np.cumsum([0, *(len(mesh) for mesh in meshes)])
        self._starts = {mesh: int(start) for mesh, start in zip(phases, starts[1:-1], strict=True)}
        self._normals = np.concatenate([unit_normals(mesh) for mesh in meshes])
        self._rounding = rounding(tuple(phases))
        self._materials = np.append(merged(meshes).material, np.uint8(_NO_MATERIAL))

    @property
    def static(self) -> Mesh:
        """All that never moves."""
        return self._static

    @property
    def actors(self) -> tuple[Actor, ...]:
        """All bodies; the first, the ego vehicle, is never hit."""
        return self._actors

    def cast(self, rays: Rays, states: BodyStates) -> Hits:
        """Follow rays to the first surface."""
        range_m, triangle = self._world.nearest(_origins(rays), rays.direction, rays.range_m)
        missed = triangle < 0
        range_m[missed] = np.inf
        body = np.where(missed, np.int32(MISS), np.int32(STATIC))
        aim = _Aim(rays, states)
        alone = []
        for i, scene in self._others(states):
            reached, origin_m, direction = aim.at(i, scene)
            if len(reached):
                near_m, near = scene.nearest(origin_m, direction, rays.range_m)
                hit = merge_nearer(reached, near_m, near, i, range_m, body, triangle)
                alone += [(i, hit)] if len(hit) else []
        normal = facing_normals(
            body, triangle, rays.direction, aim.offset_s, aim.bodies, self._first(states), self._normals
        )
        return Hits(range_m, body, triangle, normal, tuple(alone))

    def blocked(self, rays: Rays, states: BodyStates) -> Bool:
        """Tell of which rays (N,) something is in the way within their range: shadows."""
        found = self._world.blocks(_origins(rays), rays.direction, rays.range_m)
        free = np.flatnonzero(~found)
        aim = _Aim(_some(rays, free), states)
        for i, scene in self._others(states):
            reached, origin_m, direction = aim.at(i, scene)
            if len(reached):
                found[free[reached[scene.blocks(origin_m, direction, rays.range_m)]]] = True
        return found

    def material(self, hits: Hits, states: BodyStates) -> Array:
        """Indices (N,) uint8 into `MATERIALS` of what was hit; 255 where nothing was."""
        first = np.append(self._first(states), [len(self._materials), 0])  # MISS (with triangle -1) and STATIC
        return np.asarray(self._materials[first[hits.body] + hits.triangle])

    def smoothed(self, rays: Rays, hits: Hits, states: BodyStates) -> Float32:
        """Normals (N, 3) as if bodies were round where their triangles meet at small angles."""
        bodies = np.column_stack([states.position_m, states.yaw_rad])
        first = self._first(states) - len(self._static)
        return round_normals(
            hits.body, hits.triangle, hits.range_m, rays.direction, rays.origin_m[0], hits.normal, bodies, first,
            self._rounding,
        )  # fmt: skip

    def _others(self, states: BodyStates) -> list[tuple[int, Scene]]:
        scenes = ((i, self._scenes[self._mesh(i, states)]) for i in range(EGO + 1, len(self._actors)))
        return [(i, scene) for i, scene in scenes if not scene.is_empty]

    def _first(self, states: BodyStates) -> Int64:
        """Where the mesh of each body begins among all meshes."""
        return np.array([self._starts[self._mesh(i, states)] for i in range(len(self._actors))], np.int64)

    def _mesh(self, i: int, states: BodyStates) -> Mesh:
        body = self._actors[i].body
        return body.phases[body.mesh_at(float(states.phase[i]))]


class _Aim:
    """Rays, ready to be sorted by the bodies that they can hit."""

    def __init__(self, rays: Rays, states: BodyStates) -> None:
        self.bodies: Float64 = np.column_stack(
            [states.position_m, states.yaw_rad, states.velocity_mps, states.yaw_rate_radps]
        )
        self.offset_s: Float64 = _NO_OFFSETS if rays.offset_s is None else rays.offset_s
        self._rays = rays
        self._starts = starts_of_blocks(rays.direction)
        self._blocks = cones_of_blocks(self._starts, rays.origin_m, rays.direction, self.offset_s)

    def at(self, i: int, scene: Scene) -> tuple[Int64, Float32, Float32]:
        """Return the rays (M,) that meet the box of body `i`, with origins and directions in its coordinates."""
        rays = self._rays
        return rays_at_body(
            self._blocks, self._starts, rays.origin_m, rays.direction, self.offset_s, float(rays.range_m),
            self.bodies[i], scene.box_m,
        )  # fmt: skip


def _origins(rays: Rays) -> Float32:
    return np.broadcast_to(rays.origin_m.astype(np.float32), rays.direction.shape)


def _some(rays: Rays, chosen: Int64) -> Rays:
    origin_m = rays.origin_m if len(rays.origin_m) == 1 else rays.origin_m[chosen]
    offset_s = None if rays.offset_s is None else rays.offset_s[chosen]
    return Rays(origin_m, rays.direction[chosen], rays.range_m, offset_s)
