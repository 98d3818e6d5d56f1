"""Simple shapes of one material and colour, from which bodies and scenery are made."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.materials import INDEX
from fbench.datasets.city.mesh import Mesh
from fbench.replay.arrays import Array, Float64

Rgb = tuple[float, float, float]
"""Linear red, green, blue, 0 to 1."""
Three = tuple[float, float, float]


@dataclass(frozen=True)
class Skin:
    """How a shape looks."""

    material: str
    color: Rgb
    lamp: int = -1


def mesh(vertices_m: Array, triangles: Array, skin: Skin) -> Mesh:
    """Return a mesh of one skin from vertices (V, 3) and triangles (T, 3), counter-clockwise from outside."""
    num = len(triangles)
    return Mesh(
        np.asarray(vertices_m, np.float32),
        np.asarray(triangles, np.int32),
        np.full(num, INDEX[skin.material], np.uint8),
        np.tile(np.asarray(skin.color, np.float32), (num, 1)),
        np.full(num, skin.lamp, np.int32),
    )


def quad(corners_m: Array, skin: Skin) -> Mesh:
    """Return a flat quadrilateral from corners (4, 3), counter-clockwise from outside."""
    return mesh(np.asarray(corners_m), np.array([[0, 1, 2], [0, 2, 3]]), skin)


def box(center_m: Three, size_lwh_m: Three, skin: Skin) -> Mesh:
    """Return a box whose edges are along the axes."""
    x, y, _ = np.asarray(size_lwh_m) / 2
    outline = np.asarray([(-x, -y), (x, -y), (x, y), (-x, y)]) + np.asarray(center_m[:2])
    return prism(outline, center_m[2] - size_lwh_m[2] / 2, center_m[2] + size_lwh_m[2] / 2, skin)


def prism(outline_m: Array, bottom_m: float, top_m: float, skin: Skin) -> Mesh:
    """Extrude a convex outline (P, 2) in x and y, counter-clockwise from above, with both ends closed."""
    flat = np.asarray(outline_m, np.float64)
    sections = [np.column_stack([flat, np.full(len(flat), z)]) for z in (bottom_m, top_m)]
    return loft(sections, skin)


def cylinder(
    start_m: Three, end_m: Three, radius_m: float, num_sides: int, skin: Skin, end_radius_m: float = -1.0
) -> Mesh:
    """Return a closed cylinder, or a cone where the radius at its end is another."""
    a, b = np.asarray(start_m, np.float64), np.asarray(end_m, np.float64)
    u, v = _across(b - a)
    angle = np.arange(num_sides) * (2 * np.pi / num_sides)
    ring = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v
    return loft([a + radius_m * ring, b + (radius_m if end_radius_m < 0 else end_radius_m) * ring], skin)


def loft(sections_m: Sequence[Float64], skin: Skin, closed: bool = True) -> Mesh:
    """Join convex rings of P points each, (P, 3), one after the other; both ends are closed unless `closed` is false.

    Seen along the way from the first ring to the last, points run clockwise: from its end, counter-clockwise.
    """
    num, last = len(sections_m[0]), len(sections_m) - 1
    i = np.arange(num)
    j = (i + 1) % num
    sides = [_band(i + k * num, j + k * num, num) for k in range(last)]
    fan = np.column_stack([np.zeros(num - 2, int), np.arange(1, num - 1), np.arange(2, num)])
    ends = [fan[:, ::-1], fan + last * num] if closed else []
    return mesh(np.concatenate(sections_m), np.concatenate([*sides, *ends]), skin)


def _band(i: Array, j: Array, num: int) -> Array:
    return np.concatenate([np.column_stack([i, j, j + num]), np.column_stack([i, j + num, i + num])])


def _across(axis: Float64) -> tuple[Float64, Float64]:
    """Two unit vectors across an axis, which they follow right-handed."""
    axis = axis / np.sqrt((axis * axis).sum())
    start = np.array([0.0, 0, 1]) if abs(axis[2]) < 0.9 else np.array([1.0, 0, 0])
    u = np.cross(start, axis)
    u = u / np.sqrt((u * u).sum())
    return u, np.cross(axis, u)
