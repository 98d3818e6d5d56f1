"""The ray caster on Embree, with a scene for the static world and one for each body's mesh, its culling of rays, and
the instants that sensors see through it.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from embreex.rtcore import EmbreeDevice

from fbench.datasets.city.instant import EGO, MISS, STATIC, BodyStates, Hits, Rays
from fbench.datasets.city.mesh import Actor, Mesh, merge_meshes
from fbench.datasets.city.rays.smooth import Scene, round_normals, rounding, unit_normals
from fbench.replay.conditions.generators import generator
from fbench.replay.conditions.weather import Weather
from fbench.replay.data.arrays import Array, Bool, Float32, Float64, Int64
from fbench.replay.geometry.kernels import kernel, kernel_part
from fbench.replay.geometry.transforms import chain

_MOST = 32  # Rays that follow each other and are tested together, at most
_TOGETHER = 0.9  # Cosine of the angle within which they are: else rows of images would be torn at their ends
_PARALLEL = 1e-12
_SLACK = 1e-6

Blocks: TypeAlias = Float64
"""(10, B): middle of the origins (3) and their farthest from it [m], the cone's axis (3), cosine and sine of its half
angle, longest offset [s].
"""


@kernel
def starts_of_blocks(direction: Float32) -> Int64:
    """Return where each block of rays begins and the last one ends (B + 1,)."""
    starts = np.zeros(len(direction) + 1, np.int64)
    num, first = 0, 0
    for k in range(1, len(direction)):
        along = 0.0
        for axis in range(3):
            along += direction[first, axis] * direction[k, axis]
        if k - first == _MOST or along < _TOGETHER:
            num, first = num + 1, k
            starts[num] = k
    num += min(1, len(direction))
    starts[num] = len(direction)
    return starts[: num + 1]


@kernel
def cones_of_blocks(starts: Int64, origin_m: Float64, direction: Float32, offset_s: Float64) -> Blocks:
    """Return cones around blocks of rays. Origins are (N, 3) or (1, 3), offsets (N,) or (0,)."""
    blocks = np.zeros((10, len(starts) - 1))
    for b in range(len(starts) - 1):
        first, end, block = starts[b], starts[b + 1], blocks[:, b]
        if len(origin_m) == 1:
            block[0:3] = origin_m[0]
        else:
            for axis in range(3):  # the middle between the least and the most
                least = most = origin_m[first, axis]
                for k in range(first + 1, end):
                    least, most = min(least, origin_m[k, axis]), max(most, origin_m[k, axis])
                block[axis] = 0.5 * (least + most)
            worst = 0.0
            for k in range(first, end):
                x, y, z = origin_m[k, 0] - block[0], origin_m[k, 1] - block[1], origin_m[k, 2] - block[2]
                worst = max(worst, x * x + y * y + z * z)
            block[3] = math.sqrt(worst)
        angle = _cone(direction, block, first, end)
        block[7], block[8] = math.cos(angle), math.sin(angle)
        for k in range(first, end if len(offset_s) else first):
            block[9] = max(block[9], abs(offset_s[k]))
    return blocks


@kernel_part
def _cone(direction: Float32, block: Float64, first: int, end: int) -> float:
    """Write the axis of the cone around directions into `block`; returns its half angle [rad]."""
    x, y, z = 0.0, 0.0, 0.0
    for k in range(first, end):
        x += direction[k, 0]
        y += direction[k, 1]
        z += direction[k, 2]
    length = math.sqrt(x * x + y * y + z * z)
    if length < _SLACK * (end - first):
        return math.pi
    x, y, z = x / length, y / length, z / length
    block[4], block[5], block[6] = x, y, z
    least = 1.0
    for k in range(first, end):
        least = min(least, x * direction[k, 0] + y * direction[k, 1] + z * direction[k, 2])
    return math.acos(max(-1.0, least)) + 1e-3  # single precision makes small angles uncertain by 3e-4


@kernel_part
def _reach_body(blocks: Blocks, body: Float64, box: Float64, range_m: float) -> Int64:
    """Return the blocks of which a ray can touch the sphere about a body's box, wherever that is meanwhile."""
    cos, sin = math.cos(body[3]), math.sin(body[3])
    middle_x = body[0] + cos * box[0] - sin * box[1]
    middle_y = body[1] + sin * box[0] + cos * box[1]
    swing = abs(body[7]) * math.sqrt(box[0] * box[0] + box[1] * box[1])
    speed = math.sqrt(body[4] * body[4] + body[5] * body[5] + body[6] * body[6]) + swing
    radius = math.sqrt(box[3] * box[3] + box[4] * box[4] + box[5] * box[5])
    middle_z = body[2] + box[2]
    num = blocks.shape[1]
    touched = np.empty(num, np.uint8)
    for b in range(num):  # free of branches and in this form it is vectorised: five times as fast
        x, y, z = middle_x - blocks[0, b], middle_y - blocks[1, b], middle_z - blocks[2, b]
        reach = radius + blocks[3, b] + speed * blocks[9, b]
        distance2, along = x * x + y * y + z * z, x * blocks[4, b] + y * blocks[5, b] + z * blocks[6, b]
        over, farthest = math.sqrt(abs(distance2 - reach * reach)), reach + range_m
        wide = (distance2 <= reach * reach) | (blocks[7, b] <= 0)
        # on the right cos(cone's + sphere's half angle) times the distance
        within = (along >= blocks[7, b] * over - blocks[8, b] * reach) & (distance2 <= farthest * farthest)
        touched[b] = wide | within
    return np.flatnonzero(touched)


@kernel
def rays_at_body(
    blocks: Blocks, starts: Int64, origin_m: Float64, direction: Float32, offset_s: Float64, range_m: float,
    body: Float64, box: Float64,
) -> tuple[Int64, Float32, Float32]:  # fmt: skip
    """Return the rays (M,) that meet a body's box, ascending, and their origins and directions (M, 3) in its
    coordinates at each ray's offset. `body` (8,) is its position, yaw, velocity and yaw rate; `box` (6,) middle and
    half size in its own coordinates.
    """
    chosen = _reach_body(blocks, body, box, range_m)
    rays = np.empty(len(chosen) * _MOST, np.int64)
    ray = np.empty((len(chosen) * _MOST, 6), np.float32)
    found, num_origins, num_offsets = 0, len(origin_m), len(offset_s)
    x, y, z, cos, sin = _start(origin_m[0] if len(chosen) else np.zeros(3), body, 0.0)
    for b in chosen:
        for k in range(starts[b], starts[b + 1]):
            if num_offsets or num_origins > 1:
                x, y, z, cos, sin = _start(
                    origin_m[k if num_origins > 1 else 0], body, offset_s[k] if num_offsets else 0.0
                )
            u = cos * direction[k, 0] + sin * direction[k, 1]
            v = cos * direction[k, 1] - sin * direction[k, 0]
            w = np.float64(direction[k, 2])
            dx, dy, dz = x - box[0], y - box[1], z - box[2]
            if _meets_sphere(dx, dy, dz, u, v, w, box) and _meets_box(dx, dy, dz, u, v, w, box, range_m):
                rays[found] = k
                ray[found, 0], ray[found, 1], ray[found, 2] = x, y, z
                ray[found, 3], ray[found, 4], ray[found, 5] = u, v, w
                found += 1
    return rays[:found], ray[:found, :3], ray[:found, 3:]


@kernel_part
def _start(origin_m: Float64, body: Float64, offset_s: float) -> tuple[float, float, float, float, float]:
    """Return an origin in a body's coordinates at an offset, and cosine and sine of its yaw then."""
    yaw = body[3] + body[7] * offset_s
    cos, sin = math.cos(yaw), math.sin(yaw)
    x = origin_m[0] - body[0] - body[4] * offset_s
    y = origin_m[1] - body[1] - body[5] * offset_s
    return cos * x + sin * y, cos * y - sin * x, origin_m[2] - body[2] - body[6] * offset_s, cos, sin


@kernel_part
def _meets_sphere(x: float, y: float, z: float, u: float, v: float, w: float, box: Float64) -> bool:
    """Return whether a ray from (x, y, z) along (u, v, w) meets the sphere about 0."""
    along, beyond = x * u + y * v + z * w, (x * x + y * y + z * z) * (1 - _SLACK)
    beyond -= box[3] * box[3] + box[4] * box[4] + box[5] * box[5]
    return beyond <= 0 or (along < 0 and along * along >= beyond)


@kernel_part
def _meets_box(x: float, y: float, z: float, u: float, v: float, w: float, box: Float64, range_m: float) -> bool:
    """Return whether it passes through the box about 0 within its range."""
    enters, leaves = _within(x, u, box[3], 0.0, range_m)
    enters, leaves = _within(y, v, box[4], enters, leaves)
    enters, leaves = _within(z, w, box[5], enters, leaves)
    return enters <= leaves


@kernel_part
def _within(start: float, slope: float, half: float, enters: float, leaves: float) -> tuple[float, float]:
    """Narrow the stretch of a ray to where it is between two planes."""
    if abs(slope) < _PARALLEL:
        return (enters, leaves) if abs(start) <= half else (1.0, 0.0)
    a, b = (-half - start) / slope, (half - start) / slope
    return max(enters, min(a, b)), min(leaves, max(a, b))


@kernel
def merge_nearer(
    rays: Int64, range_m: Float32, triangle: Int64, body: int,
    best_m: Float32, best_body: Int64, best_triangle: Int64,
) -> Int64:  # fmt: skip
    """Take over what is nearer than the best so far; returns those of `rays` that hit at all."""
    hit = np.empty(len(rays), np.int64)
    num = 0
    for i in range(len(rays)):
        if triangle[i] >= 0:
            k = rays[i]
            hit[num] = k
            num += 1
            if range_m[i] < best_m[k]:
                best_m[k], best_body[k], best_triangle[k] = range_m[i], body, triangle[i]
    return hit[:num]


@kernel
def facing_normals(
    body: Array, triangle: Array, direction: Float32, offset_s: Float64, bodies: Float64, first: Int64,
    normals: Float32,
) -> Float32:  # fmt: skip
    """Return unit normals (N, 3) in the world, towards where rays come from; 0 for misses. `normals` are those of all
    meshes in their own coordinates, one mesh after the other; `first` (A,) is where the mesh of each body begins, and
    the static world's are the first. `bodies` (A, 8) as in `rays_at_body`.
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


_NO_OFFSETS: Float64 = np.zeros(0)
_NO_OFFSETS.setflags(write=False)  # like those of rays: kernels are compiled for one kind of array only


class EmbreeCaster:
    """Casts rays at a static world and at actors wherever they are. Never changes, so threads can share it. Bodies are
    met in their own coordinates, so that distance from the world's origin costs them no precision.
    """

    def __init__(self, static: Mesh, actors: tuple[Actor, ...]) -> None:
        self.static = static  # All that never moves
        self.actors = actors
        """All bodies; the first, the ego vehicle, is never hit."""
        phases = dict.fromkeys(mesh for actor in actors for mesh in actor.body.phases)
        device = EmbreeDevice()
        self._scenes = {mesh: Scene(mesh, device) for mesh in phases}
        self._world = Scene(static, device)
        meshes = (static, *phases)
        starts = np.cumsum([0, *(len(mesh) for mesh in meshes)])
        self._starts = {mesh: int(start) for mesh, start in zip(phases, starts[1:-1], strict=True)}
        self._normals = np.concatenate([unit_normals(mesh) for mesh in meshes])
        self._rounding = rounding(tuple(phases))
        self._materials = np.append(merge_meshes(meshes).material, np.uint8(255))

    def cast(self, rays: Rays, states: BodyStates) -> Hits:
        """Follow rays to the first surface."""
        range_m, triangle = self._world.nearest(rays.origin_m, rays.direction, rays.range_m)
        missed = triangle < 0
        range_m[missed] = np.inf
        body = np.where(missed, np.int32(MISS), np.int32(STATIC))
        alone = []
        for i, scene, reached, origin_m, direction in self._meet(rays, states):
            near_m, near = scene.nearest(origin_m, direction, rays.range_m)
            hit = merge_nearer(reached, near_m, near, i, range_m, body, triangle)
            alone += [(i, hit)] if len(hit) else []
        offset_s = _NO_OFFSETS if rays.offset_s is None else rays.offset_s
        first = self._first(states)
        normal = facing_normals(body, triangle, rays.direction, offset_s, _poses(states), first, self._normals)
        return Hits(range_m, body, triangle, normal, tuple(alone))

    def is_blocked(self, rays: Rays, states: BodyStates) -> Bool:
        """Return of which rays (N,) something is in the way within their range: shadows."""
        blocked = self._world.blocks(rays.origin_m, rays.direction, rays.range_m)
        free = np.flatnonzero(~blocked)
        origin = rays.origin_m if len(rays.origin_m) == 1 else rays.origin_m[free]
        offset_s = None if rays.offset_s is None else rays.offset_s[free]
        others = Rays(origin, rays.direction[free], rays.range_m, offset_s)
        for _, scene, reached, origin_m, direction in self._meet(others, states):
            blocked[free[reached[scene.blocks(origin_m, direction, rays.range_m)]]] = True
        return blocked

    def material(self, hits: Hits, states: BodyStates) -> Array:
        """Indices (N,) uint8 into `MATERIALS` of what was hit; 255 where nothing was."""
        first = np.append(self._first(states), [len(self._materials), 0])  # MISS (with triangle -1) and STATIC
        return np.asarray(self._materials[first[hits.body] + hits.triangle])

    def smooth_normals(self, rays: Rays, hits: Hits, states: BodyStates) -> Float32:
        """Normals (N, 3) like `Hits.normal`, as if bodies were round where their triangles meet at small angles: for
        shading. All rays have one origin and no offset.
        """
        bodies = np.column_stack([states.position_m, states.yaw_rad])
        first = self._first(states) - len(self.static)
        return round_normals(
            hits.body, hits.triangle, hits.range_m, rays.direction, rays.origin_m[0], hits.normal, bodies, first,
            self._rounding,
        )  # fmt: skip

    def _meet(self, rays: Rays, states: BodyStates) -> Iterator[tuple[int, Scene, Int64, Float32, Float32]]:
        """Yield each body of which rays (M,) meet the box, with these, and their origins and directions in its
        coordinates.
        """
        offset_s, bodies = _NO_OFFSETS if rays.offset_s is None else rays.offset_s, _poses(states)
        starts = starts_of_blocks(rays.direction)
        blocks = cones_of_blocks(starts, rays.origin_m, rays.direction, offset_s)
        for i in range(EGO + 1, len(self.actors)):
            scene = self._scenes[self._mesh(i, states)]
            if not scene.is_empty:
                reached, origin_m, direction = rays_at_body(
                    blocks, starts, rays.origin_m, rays.direction, offset_s, float(rays.range_m), bodies[i], scene.box_m
                )
                if len(reached):
                    yield i, scene, reached, origin_m, direction

    def _first(self, states: BodyStates) -> Int64:
        """Where the mesh of each body begins among all meshes."""
        return np.array([self._starts[self._mesh(i, states)] for i in range(len(self.actors))], np.int64)

    def _mesh(self, i: int, states: BodyStates) -> Mesh:
        body = self.actors[i].body
        return body.phases[body.mesh_at(float(states.phase[i]))]


def _poses(states: BodyStates) -> Float64:
    return np.column_stack([states.position_m, states.yaw_rad, states.velocity_mps, states.yaw_rate_radps])


@dataclass(frozen=True, eq=False)
class Instant:
    """The world around one sensor when it measures; what it is like itself is said by its spec."""

    caster: EmbreeCaster
    states: BodyStates  # Of all bodies at `stamp_ns`
    weather: Weather
    street_lamps_m: Float64  # (L, 3) in the world
    seed: int  # Of all chances
    sensor: str  # Its name
    body_T_sensor: Float64  # (4, 4) its mount on the ego vehicle
    stamp_ns: int
    log_ns: int  # When the message arrives

    @property
    def world_T_sensor(self) -> Float64:
        """Pose (4, 4) of the sensor in the world."""
        return chain(self.states.world_T_body(EGO), self.body_T_sensor)

    def generator(self, what: str, *scope: str) -> np.random.Generator:
        """Return the random numbers for `what` in the sensor's one message."""
        return generator(self.seed, what, self.sensor, self.stamp_ns, *scope)
