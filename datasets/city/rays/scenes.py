"""Embree's scene of one mesh."""

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene

from fbench.datasets.city.mesh import Mesh
from fbench.replay.arrays import Array, Bool, Float32, Float64

_FARTHEST_M = 1e30
_MARGIN_M = 1e-3


class Scene:
    """One mesh in its own coordinates, ready to be hit. Never changes, so threads can share it."""

    def __init__(self, mesh: Mesh, device: EmbreeDevice) -> None:
        """Build the scene on a device, which all scenes share: Embree crashes where there are a thousand devices."""
        self.box_m = _box(mesh)
        self.is_empty = len(mesh) == 0
        self._scene = EmbreeScene(device, robust=True)  # watertight: no ray slips through between two triangles
        TriangleMesh(self._scene, np.array(mesh.vertices_m, np.float32), np.array(mesh.triangles, np.int32))
        nothing = np.zeros((0, 3), np.float32)
        self._scene.run(nothing, nothing)  # builds the tree, which must not happen while threads share it

    def nearest(self, origin_m: Float32, direction: Float32, range_m: float) -> tuple[Float32, Array]:
        """Return how far (N,) the first surface is and its triangle (N,) int32, -1 where there is none.

        Origins (N, 3) and unit vectors (N, 3) are in the mesh's coordinates; what is said of misses is undefined.
        """
        found = self._scene.run(origin_m, direction, dists=_limits(len(direction), range_m), output=True)
        return found["tfar"], found["primID"]

    def blocks(self, origin_m: Float32, direction: Float32, range_m: float) -> Bool:
        """Tell of which rays (N,) the mesh is in the way within `range_m`."""
        found = self._scene.run(origin_m, direction, dists=_limits(len(direction), range_m), query="OCCLUDED")
        return np.asarray(found == 0)


def _limits(num: int, range_m: float) -> Float32:
    return np.full(num, min(range_m, _FARTHEST_M), np.float32)


def _box(mesh: Mesh) -> Float64:
    """Middle and half size (6,) of the box around a mesh, a little larger."""
    if not len(mesh):
        return np.zeros(6)
    used = np.asarray(mesh.vertices_m, np.float64)[np.unique(mesh.triangles)]
    low, high = used.min(axis=0) - _MARGIN_M, used.max(axis=0) + _MARGIN_M
    return np.concatenate([(low + high) / 2, (high - low) / 2])


def unit_normals(mesh: Mesh) -> Float32:
    """Return the unit normals (T, 3) of triangles; 0 where one has no area, which no ray can hit."""
    a, b, c = (np.asarray(mesh.vertices_m, np.float64)[mesh.triangles[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    length = np.sqrt((cross * cross).sum(axis=1))
    return np.asarray(cross / np.where(length > 0, length, 1)[:, None], np.float32)
