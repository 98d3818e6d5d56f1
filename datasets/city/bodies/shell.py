"""Surfaces between cross-sections, and bodies whose box is exact."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from fbench.datasets.city.mesh import INDEX, Body, Mesh, Skin, cross, merge_meshes, shift
from fbench.replay.data.arrays import Array, Float64

_LEAST_AREA_M2 = 1e-7  # Smaller triangles are left out: nothing would be seen through the gap


def shell(
    sections_m: Float64, cells: Array, palette: Sequence[Skin], ends: tuple[Array | int, Array | int] | None = (0, 0)
) -> Mesh:
    """Join rings (S, K, 3), which run counter-clockwise seen from the last one, by cells (S - 1, K) of two triangles.
    `cells` are indices into `palette`; cell k lies between points k and k + 1. `ends` are the skins of both ends, which
    must be convex, or of each of the K triangles around their middles; `None` leaves them open.
    """
    num, around = sections_m.shape[:2]
    points = np.concatenate([sections_m.reshape(-1, 3), sections_m[[0, -1]].mean(1)])
    stars = None if ends is None else tuple(not isinstance(end, int) for end in ends)
    triangles, *fans = _join(num, around, stars)
    skin: list[Array] = [np.repeat(np.ravel(cells), 2)]
    skin += [np.broadcast_to(np.asarray(end), len(fan)) for end, fan in zip(ends or (), fans, strict=True)]
    return skin_surface(points, np.concatenate([triangles, *fans]), np.concatenate(skin), palette)


@lru_cache(256)
def _join(num: int, around: int, stars: tuple[bool, ...] | None) -> list[Array]:
    """Return the triangles between rings, and those of both ends: stars about their middles, or fans."""
    i = np.arange(around)
    j = (i + 1) % around
    cell = np.stack([i, j, j + around, i, j + around, i + around], axis=1)
    found = [(cell[None] + np.arange(num - 1)[:, None, None] * around).reshape(-1, 3)]
    for at, is_star in zip((0, num - 1), stars or (), strict=stars is not None):
        if is_star:
            fan = np.column_stack([np.full(around, num * around - at * around + (at > 0)), i, j])
        else:
            fan = np.column_stack([np.zeros(around - 2, int), i[1:-1], i[2:]])
        found.append((fan if at else fan[:, ::-1]) + at * around)
    return found


def skin_surface(vertices_m: Float64, triangles: Array, skin: Array, palette: Sequence[Skin]) -> Mesh:
    """Return the mesh of triangles (T, 3) whose skins (T,) are given by number; without those that have no area."""
    a, b, c = (vertices_m[triangles[:, k]] for k in range(3))
    normal = cross(b - a, c - a)
    keep = (normal * normal).sum(1) > (2 * _LEAST_AREA_M2) ** 2
    skin = skin[keep]
    material = np.array([INDEX[s.material] for s in palette], np.uint8)[skin]
    color = np.array([s.color for s in palette], np.float32)[skin]
    lamp = np.array([s.lamp for s in palette], np.int32)[skin]
    return Mesh(vertices_m.astype(np.float32), triangles[keep].astype(np.int32), material, color, lamp)


def tube(path_m: ArrayLike, radii_m: Array, num_sides: int, skins: Sequence[Skin]) -> Mesh:
    """Return a closed tube along points (M, 3) with radii (M,), or (M, 2) across and along the path's plane. `skins`
    has one skin for all, or one for each of the M - 1 segments.
    """
    path = np.asarray(path_m, np.float64)
    radii = np.asarray(radii_m, np.float64).reshape(len(path), -1)
    step = np.diff(path, axis=0)
    step /= np.sqrt((step * step).sum(1, keepdims=True))
    tangent = np.concatenate([step[:1], step[:-1] + step[1:], step[-1:]])
    tangent /= np.sqrt((tangent * tangent).sum(1, keepdims=True))
    # unit vectors (M, 3) across the path: to the left where it can be, and right-handed to that
    axis = np.array([0.0, 0, 1]) if np.abs(tangent[:, 1]).max() > 0.8 else np.array([0.0, 1, 0])
    u = axis - (tangent * axis).sum(1, keepdims=True) * tangent
    u /= np.sqrt((u * u).sum(1, keepdims=True))
    v = cross(tangent, u)
    angle = np.arange(num_sides) * (2 * np.pi / num_sides) + np.pi / num_sides
    across, along = radii[:, 0, None] * np.cos(angle), radii[:, -1, None] * np.sin(angle)
    rings = path[:, None] + across[..., None] * u[:, None] + along[..., None] * v[:, None]
    last = len(skins) - 1
    cells = np.minimum(np.arange(len(path) - 1), last)[:, None] + np.zeros(num_sides, int)
    return shell(rings, cells, skins, (0, last))


def mirror(mesh: Mesh) -> Mesh:
    """Swap left and right."""
    return replace(
        mesh, vertices_m=mesh.vertices_m * np.array([1, -1, 1], np.float32), triangles=mesh.triangles[:, ::-1]
    )


def both(mesh: Mesh) -> Mesh:
    """Return what is on the left, on both sides."""
    return merge_meshes([mesh, mirror(mesh)])


def body(label: str, phases: Sequence[Sequence[Mesh]]) -> Body:
    """Center the parts of all phases on their common box and set that box; each phase stands on the ground."""
    wholes = [merge_meshes(parts) for parts in phases]
    low = np.min([whole.vertices_m.min(0) for whole in wholes], axis=0).astype(np.float64)
    high = np.max([whole.vertices_m.max(0) for whole in wholes], axis=0).astype(np.float64)
    x, y, _ = (low + high) / 2
    meshes = tuple(shift(whole, (-x, -y, -float(whole.vertices_m[:, 2].min()))) for whole in wholes)
    reach = np.max([np.abs(mesh.vertices_m).max(0) for mesh in meshes], axis=0).astype(np.float64)
    return Body(label, (2 * float(reach[0]), 2 * float(reach[1]), float(reach[2])), meshes)
