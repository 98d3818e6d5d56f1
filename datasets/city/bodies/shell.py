"""Surfaces between cross-sections, their colors, and bodies whose box is exact."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from fbench.datasets.city.mesh import INDEX, Body, Mesh, Rgb, Skin, merge_meshes
from fbench.replay.data.arrays import Array, Float64

_LEAST_AREA_M2 = 1e-7  # Smaller triangles are left out: nothing would be seen through the gap


def shell(
    sections_m: Float64, cells: Array, palette: Sequence[Skin], ends: tuple[Array | int, Array | int] | None = (0, 0)
) -> Mesh:
    """Join rings (S, K, 3), which run counter-clockwise seen from the last one, by cells (S - 1, K) of two triangles.

    `cells` are indices into `palette`; cell k lies between points k and k + 1. `ends` are the skins of both ends,
    which must be convex, or of each of the K triangles around their middles; `None` leaves them open.
    """
    num, around = sections_m.shape[:2]
    points = np.concatenate([sections_m.reshape(-1, 3), sections_m[[0, -1]].mean(1)])
    tri, skin = [_sides(num, around)], [np.repeat(np.ravel(cells), 2)]
    for at, end in ((0, ends[0]), (num - 1, ends[1])) if ends is not None else ():
        fan = _fan(around) if isinstance(end, int) else _star(around, num * around - at * around + (at > 0))
        tri.append((fan if at else fan[:, ::-1]) + at * around)
        skin.append(np.broadcast_to(np.asarray(end), len(fan)))
    return skin_surface(points, np.concatenate(tri), np.concatenate(skin), palette)


def skin_surface(vertices_m: Float64, triangles: Array, skin: Array, palette: Sequence[Skin]) -> Mesh:
    """Return the mesh of triangles (T, 3) whose skins (T,) are given by number; without those that have no area."""
    a, b, c = (vertices_m[triangles[:, k]] for k in range(3))
    u, v = b - a, c - a
    normal = np.stack([u[:, i] * v[:, j] - u[:, j] * v[:, i] for i, j in ((1, 2), (2, 0), (0, 1))])
    keep = (normal * normal).sum(0) > (2 * _LEAST_AREA_M2) ** 2
    skin = skin[keep]
    material = np.array([INDEX[s.material] for s in palette], np.uint8)
    color = np.array([s.color for s in palette], np.float32)
    lamp = np.array([s.lamp for s in palette], np.int32)
    return Mesh(vertices_m.astype(np.float32), triangles[keep].astype(np.int32), material[skin], color[skin],
                lamp[skin])  # fmt: skip


def tube(path_m: ArrayLike, radii_m: Array, num_sides: int, skins: Sequence[Skin]) -> Mesh:
    """Return a closed tube along points (M, 3) with radii (M,), or (M, 2) across and along the path's plane.

    `skins` has one skin for all, or one for each of the M - 1 segments.
    """
    path = np.asarray(path_m, np.float64)
    radii = np.asarray(radii_m, np.float64).reshape(len(path), -1)
    u, v = _frames(path)
    angle = np.arange(num_sides) * (2 * np.pi / num_sides) + np.pi / num_sides
    across, along = radii[:, 0, None] * np.cos(angle), radii[:, -1, None] * np.sin(angle)
    rings = path[:, None] + across[..., None] * u[:, None] + along[..., None] * v[:, None]
    last = len(skins) - 1
    cells = np.minimum(np.arange(len(path) - 1), last)[:, None] + np.zeros(num_sides, int)
    return shell(rings, cells, skins, (0, last))


def mirror(mesh: Mesh) -> Mesh:
    """Swap left and right."""
    vertices = mesh.vertices_m * np.array([1, -1, 1], np.float32)
    return Mesh(vertices, mesh.triangles[:, ::-1], mesh.material, mesh.color, mesh.lamp)


def both(mesh: Mesh) -> Mesh:
    """Return what is on the left, on both sides."""
    return merge_meshes([mesh, mirror(mesh)])


def shift(mesh: Mesh, by_m: tuple[float, float, float]) -> Mesh:
    """Move a mesh without turning it."""
    return Mesh(mesh.vertices_m + np.asarray(by_m, np.float32), mesh.triangles, mesh.material, mesh.color, mesh.lamp)


def _sides(num: int, around: int) -> Array:
    i = np.arange(around)
    j = (i + 1) % around
    cell = np.stack([i, j, j + around, i, j + around, i + around], axis=1)
    return (cell[None] + np.arange(num - 1)[:, None, None] * around).reshape(-1, 3)


def _fan(around: int) -> Array:
    return np.column_stack([np.zeros(around - 2, int), np.arange(1, around - 1), np.arange(2, around)])


def _star(around: int, middle: int) -> Array:
    i = np.arange(around)
    return np.column_stack([np.full(around, middle), i, (i + 1) % around])


def _frames(path: Float64) -> tuple[Float64, Float64]:
    """Unit vectors (M, 3) across a path: to the left where it can be, and right-handed to that."""
    step = np.diff(path, axis=0)
    step /= np.sqrt((step * step).sum(1, keepdims=True))
    tangent = np.concatenate([step[:1], step[:-1] + step[1:], step[-1:]])
    tangent /= np.sqrt((tangent * tangent).sum(1, keepdims=True))
    axis = np.array([0.0, 0, 1]) if np.abs(tangent[:, 1]).max() > 0.8 else np.array([0.0, 1, 0])
    u = axis - (tangent * axis).sum(1, keepdims=True) * tangent
    u /= np.sqrt((u * u).sum(1, keepdims=True))
    return u, np.cross(tangent, u)


def body(label: str, phases: Sequence[Sequence[Mesh]]) -> Body:
    """Center the parts of all phases on their common box and set that box; each phase stands on the ground."""
    wholes = [merge_meshes(parts) for parts in phases]
    low = np.min([whole.vertices_m.min(0) for whole in wholes], axis=0).astype(np.float64)
    high = np.max([whole.vertices_m.max(0) for whole in wholes], axis=0).astype(np.float64)
    x, y, _ = (low + high) / 2
    meshes = tuple(shift(whole, (-x, -y, -float(whole.vertices_m[:, 2].min()))) for whole in wholes)
    reach = np.max([np.abs(mesh.vertices_m).max(0) for mesh in meshes], axis=0).astype(np.float64)
    return Body(label, (2 * float(reach[0]), 2 * float(reach[1]), float(reach[2])), meshes)


def linear(code: str) -> Rgb:
    """Linear red, green and blue of an sRGB color such as "c81e1e" (IEC 61966-2-1)."""
    red, green, blue = (int(code[i : i + 2], 16) / 255 for i in (0, 2, 4))
    return _decode(red), _decode(green), _decode(blue)


def _decode(value: float) -> float:
    return value / 12.92 if value <= 0.04045 else float(((value + 0.055) / 1.055) ** 2.4)


CARS: Final = {
    "e9e9e6": 0.34, "16171a": 0.19, "6a6e72": 0.19, "b2b6ba": 0.09, "24457f": 0.08, "8f1a1c": 0.06,
    "4d3f33": 0.02, "31503f": 0.01, "c9551e": 0.01, "d8c9a4": 0.01,
}  # fmt: skip
"""sRGB of car paint and how often it is chosen: rounded from Axalta's Global Automotive Color Popularity Reports of
2020 and 2021 (white 35 %, black 19 %, gray 19 %, silver 9 %, blue 8 %)."""
VANS: Final = {"ecece8": 0.6, "b2b6ba": 0.1, "5b6065": 0.08, "1d1f22": 0.05, "24457f": 0.06, "a3191c": 0.05,
               "d9a514": 0.06}  # fmt: skip
LARGE: Final = {"e8e8e4": 0.35, "1f4287": 0.15, "a81d1d": 0.15, "d6881a": 0.08, "2c5a3a": 0.07, "8d9296": 0.12,
                "d9b21c": 0.08}  # fmt: skip
BUSES: Final = {"b01f24": 0.25, "e3b422": 0.2, "2456a0": 0.2, "e6e6e2": 0.15, "2f7d4f": 0.12, "d5701f": 0.08}
TOPS: Final = {"1c1e24": 0.22, "e6e4df": 0.12, "5c6167": 0.14, "27406e": 0.16, "8c2326": 0.08, "3f5c41": 0.07,
               "7a5a3c": 0.07, "b9a684": 0.06, "c9762a": 0.04, "5d8fb4": 0.04}  # fmt: skip
TROUSERS: Final = {"1b1d22": 0.32, "2b3a58": 0.36, "4a4d52": 0.14, "6f6149": 0.12, "9c9482": 0.06}
SKINS: Final = {"e8bd9c": 0.35, "d8a27c": 0.25, "b57d57": 0.18, "8a5a3b": 0.12, "583824": 0.1}
HAIR: Final = {"1a1512": 0.4, "3b2719": 0.3, "6b4a2b": 0.13, "b08d57": 0.08, "8b8a88": 0.09}

TYRE = Skin("rubber", linear("232425"))
BLACK = Skin("plastic", linear("1b1c1d"))
DARK = Skin("plastic", linear("2b2c2e"))
LINE = Skin("plastic", linear("101112"))
GLASS = Skin("glass", linear("1a2024"))
CHROME = Skin("metal", linear("b9bdc1"))
STEEL = Skin("metal", linear("85898d"))
PLATE = Skin("plate", linear("e8e8e2"))
_SPREAD: Final = 0.12  # How much lighter or darker a thing may be than its color in a table


def pick(draw: np.random.Generator, shares: dict[str, float]) -> Rgb:
    """Draw a color by its share, a little lighter or darker than in the table."""
    codes, weights = list(shares), np.array(list(shares.values()))
    bounds = np.cumsum(weights / weights.sum())
    code = codes[min(int(np.searchsorted(bounds, draw.random(), side="right")), len(codes) - 1)]
    factor = 1 + _SPREAD * (2 * draw.random() - 1)
    red, green, blue = (min(1.0, value * factor) for value in linear(code))
    return red, green, blue
