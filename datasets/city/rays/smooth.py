"""Embree scenes of meshes, and normals as if surfaces were round where triangles meet at small angles."""

import math
from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene

from fbench.datasets.city.mesh import Mesh, cross
from fbench.replay.data.arrays import Array, Bool, Float32, Float64, Int64
from fbench.replay.geometry.kernels import kernel, kernel_part

_FARTHEST_M = 1e30
_MARGIN_M = 1e-3


class Scene:
    """One mesh in its own coordinates, ready to be hit. Never changes, so threads can share it."""

    def __init__(self, mesh: Mesh, device: EmbreeDevice) -> None:
        """Build the scene on a device, which all scenes share: Embree crashes where there are a thousand devices."""
        self.is_empty, self.box_m = len(mesh) == 0, np.zeros(6)
        """Middle and half size (6,) of the box around the mesh, a little larger."""
        if not self.is_empty:
            is_used = np.zeros(len(mesh.vertices_m), bool)
            is_used[mesh.triangles] = True
            used = np.asarray(mesh.vertices_m, np.float64)[is_used]
            low, high = used.min(axis=0) - _MARGIN_M, used.max(axis=0) + _MARGIN_M
            self.box_m = np.concatenate([(low + high) / 2, (high - low) / 2])
        self._scene = EmbreeScene(device, robust=True)  # watertight: no ray slips through between two triangles
        TriangleMesh(self._scene, np.array(mesh.vertices_m, np.float32), np.array(mesh.triangles, np.int32))
        nothing = np.zeros((0, 3), np.float32)
        self._scene.run(nothing, nothing)  # builds the tree, which must not happen while threads share it

    def nearest(self, origin_m: Array, direction: Float32, range_m: float) -> tuple[Float32, Array]:
        """Return how far (N,) the first surface is and its triangle (N,) int32, -1 where there is none. Origins (N, 3)
        or (1, 3) and unit vectors (N, 3) are in the mesh's coordinates; what is said of misses is undefined.
        """
        limits = np.full(len(direction), min(range_m, _FARTHEST_M), np.float32)
        found = self._scene.run(_spread(origin_m, direction), direction, dists=limits, output=True)
        return found["tfar"], found["primID"]

    def blocks(self, origin_m: Array, direction: Float32, range_m: float) -> Bool:
        """Return of which rays (N,) the mesh is in the way within `range_m`."""
        limits = np.full(len(direction), min(range_m, _FARTHEST_M), np.float32)
        return np.asarray(self._scene.run(_spread(origin_m, direction), direction, dists=limits, query="OCCLUDED") == 0)


def _spread(origin_m: Array, direction: Float32) -> Float32:
    return np.broadcast_to(origin_m.astype(np.float32, copy=False), direction.shape)


def unit_normals(mesh: Mesh) -> Float32:
    """Return the unit normals (T, 3) of triangles; 0 where one has no area, which no ray can hit."""
    a, b, c = (np.asarray(mesh.vertices_m, np.float64)[mesh.triangles[:, i]] for i in range(3))
    normal = cross(b - a, c - a)
    length = np.sqrt((normal * normal).sum(axis=1))
    return np.asarray(normal / np.where(length > 0, length, 1)[:, None], np.float32)


_CREASE = math.cos(math.radians(35))  # Triangles that meet at a larger angle have an edge there
_WELD_M = 2.5e-4  # Corners within about this distance are one
_BITS = 20
_FLAT = 1 - 1e-5
_LEAST_FACING = 0.02


class Rounding(NamedTuple):
    """Corners of the T triangles of all meshes of bodies, one mesh after the other."""

    position_m: Float32  # (T, 3, 3) in the mesh's coordinates
    normal: Float32  # (T, 3, 3) unit vectors there
    is_round: Bool  # (T,) whether its normals differ from that of the triangle


def rounding(meshes: tuple[Mesh, ...]) -> Rounding:
    """Prepare the corners of meshes; each mesh is welded on its own."""
    parts = [_round_corners(mesh) for mesh in meshes]
    if not parts:
        return Rounding(np.zeros((0, 3, 3), np.float32), np.zeros((0, 3, 3), np.float32), np.zeros(0, bool))
    position, normal, is_round = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Rounding(position, normal, is_round)


def _round_corners(mesh: Mesh) -> tuple[Float32, Float32, Bool]:
    corners = np.ascontiguousarray(mesh.vertices_m[mesh.triangles])
    steps = np.round(corners.reshape(-1, 3).astype(np.float64) / _WELD_M).astype(np.int64) + (1 << (_BITS - 1))
    key = (steps[:, 0] << (2 * _BITS)) + (steps[:, 1] << _BITS) + steps[:, 2]
    _, vertex = np.unique(key, return_inverse=True)
    order = np.argsort(vertex, kind="stable")
    start = np.searchsorted(vertex[order], np.arange(len(order) + 1))
    a, b, c = (corners[:, i].astype(np.float64) for i in range(3))
    normal = cross(b - a, c - a)
    area_m2 = np.sqrt((normal * normal).sum(axis=1)) / 2
    return corners, *_corner_normals(unit_normals(mesh), area_m2, vertex.astype(np.int64), order, start)


@kernel
def _corner_normals(
    normals: Float32, area_m2: Float64, vertex: Int64, order: Int64, start: Int64
) -> tuple[Float32, Bool]:
    """Average at each corner the normals of all triangles there that turn little from its own, weighted by area."""
    result, is_round = np.empty((len(normals), 3, 3), np.float32), np.zeros(len(normals), np.bool_)
    for t in range(len(normals)):
        own = normals[t]
        for corner in range(3):
            x, y, z = 0.0, 0.0, 0.0
            at = vertex[3 * t + corner]
            for k in range(start[at], start[at + 1]):
                other = order[k] // 3
                n = normals[other]
                if n[0] * own[0] + n[1] * own[1] + n[2] * own[2] >= _CREASE:
                    x += area_m2[other] * n[0]
                    y += area_m2[other] * n[1]
                    z += area_m2[other] * n[2]
            length = math.sqrt(x * x + y * y + z * z)
            for axis, value in enumerate((x, y, z)):
                result[t, corner, axis] = value / length if length > 0 else own[axis]
            if length > 0 and (x * own[0] + y * own[1] + z * own[2]) / length < _FLAT:
                is_round[t] = True
    return result, is_round


@kernel
def round_normals(
    body: Array, triangle: Array, range_m: Float32, direction: Float32, origin_m: Float64, normal: Float32,
    bodies: Float64, first: Int64, corners: Rounding,
) -> Float32:  # fmt: skip
    """Return `normal` (N, 3) with those of bodies replaced by ones that change steadily over round surfaces. They still
    point to where the ray comes from. `origin_m` (3,) is that of all rays, `bodies` (A, 4) position and yaw, `first`
    (A,) where the triangles of each body's mesh begin in `corners`.
    """
    result, cos, sin = normal.copy(), np.cos(bodies[:, 3]), np.sin(bodies[:, 3])
    position, normals, is_round = corners.position_m, corners.normal, corners.is_round
    for k in range(len(body)):
        i = body[k]
        if i < 0 or not is_round[first[i] + triangle[k]]:
            continue
        t, r, c, s = first[i] + triangle[k], float(range_m[k]), cos[i], sin[i]
        x = origin_m[0] + r * direction[k, 0] - bodies[i, 0]
        y = origin_m[1] + r * direction[k, 1] - bodies[i, 1]
        z = origin_m[2] + r * direction[k, 2] - bodies[i, 2]
        a, b = _place(position[t], c * x + s * y, c * y - s * x, z)
        n = normals[t]
        x = n[0, 0] + a * (n[1, 0] - n[0, 0]) + b * (n[2, 0] - n[0, 0])
        y = n[0, 1] + a * (n[1, 1] - n[0, 1]) + b * (n[2, 1] - n[0, 1])
        z = n[0, 2] + a * (n[1, 2] - n[0, 2]) + b * (n[2, 2] - n[0, 2])
        _turn(result[k], c * x - s * y, s * x + c * y, z, direction[k])
    return result


@kernel_part
def _place(p: Array, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the shares of the second and third corner (3, 3) in a point of a triangle."""
    ax, ay, az = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[1, 2] - p[0, 2]
    bx, by, bz = p[2, 0] - p[0, 0], p[2, 1] - p[0, 1], p[2, 2] - p[0, 2]
    px, py, pz = x - p[0, 0], y - p[0, 1], z - p[0, 2]
    aa, ab, bb = ax * ax + ay * ay + az * az, ax * bx + ay * by + az * bz, bx * bx + by * by + bz * bz
    pa, pb, area = px * ax + py * ay + pz * az, px * bx + py * by + pz * bz, aa * bb - ab * ab
    if area <= 0:
        return 0.0, 0.0
    second = min(1.0, max(0.0, (bb * pa - ab * pb) / area))
    return second, min(1.0 - second, max(0.0, (aa * pb - ab * pa) / area))


@kernel_part
def _turn(normal: Array, x: float, y: float, z: float, direction: Array) -> None:
    """Write a normal over the flat one, on the flat one's side and facing the ray at least a little."""
    if x * normal[0] + y * normal[1] + z * normal[2] < 0:
        x, y, z = -x, -y, -z
    u, v, w = float(direction[0]), float(direction[1]), float(direction[2])
    length = max(1e-6, math.sqrt(x * x + y * y + z * z))
    over = max(0.0, (x * u + y * v + z * w) / length + _LEAST_FACING)
    x, y, z = x / length - over * u, y / length - over * v, z / length - over * w
    length = math.sqrt(x * x + y * y + z * z)
    normal[0], normal[1], normal[2] = x / length, y / length, z / length
