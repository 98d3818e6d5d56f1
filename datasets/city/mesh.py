"""Triangles with materials and colours."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Array, Float32, Float64, freeze_fields
from fbench.replay.geometry.transforms import transform


@dataclass(frozen=True, eq=False)
class Mesh:
    """V vertices and T triangles, counter-clockwise from outside."""

    vertices_m: Float32
    """(V, 3)."""
    triangles: Array
    """(T, 3) int32 indices of vertices."""
    material: Array
    """(T,) uint8 index into `materials.MATERIALS`."""
    color: Float32
    """(T, 3) linear red, green, blue, 0 to 1: the diffuse albedo, or the light's colour of what shines."""
    lamp: Array
    """(T,) int32: which switchable lamp a triangle belongs to (see `motion.Lamps`), -1 for none."""

    def __post_init__(self) -> None:
        freeze_fields(self, vertices_m=("f4", ("V", 3)), triangles=("i4", ("T", 3)), material=("u1", ("T",)),
                      color=("f4", ("T", 3)), lamp=("i4", ("T",)))  # fmt: skip

    def __len__(self) -> int:
        return len(self.triangles)


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """Join meshes into one, in their order."""
    if not meshes:
        return Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros(0, np.uint8),
                    np.zeros((0, 3), np.float32), np.zeros(0, np.int32))  # fmt: skip
    starts = np.cumsum([0, *(len(m.vertices_m) for m in meshes[:-1])])
    return Mesh(
        np.concatenate([m.vertices_m for m in meshes]),
        np.concatenate([m.triangles + np.int32(start) for m, start in zip(meshes, starts, strict=True)]),
        np.concatenate([m.material for m in meshes]),
        np.concatenate([m.color for m in meshes]),
        np.concatenate([m.lamp for m in meshes]),
    )


def moved(mesh: Mesh, dst_T_src: Float64) -> Mesh:
    """Move a mesh by a rigid transform (4, 4)."""
    vertices = transform(dst_T_src, mesh.vertices_m).astype(np.float32)
    return Mesh(vertices, mesh.triangles, mesh.material, mesh.color, mesh.lamp)
