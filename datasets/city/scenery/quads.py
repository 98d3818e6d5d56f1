"""Quadrilaterals on walls: u to the right of who looks at the wall, v up, d out of it."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from fbench.datasets.city.mesh import INDEX, Mesh, Skin, Three
from fbench.replay.data.arrays import Array, Float32, Float64

Number = float | Array  # One for all quadrilaterals, or one each


@dataclass(frozen=True, eq=False)
class Quads:
    """Q quadrilaterals, counter-clockwise from outside. Never checked: there are very many of them."""

    corners_m: Float64  # (Q, 4, 3)
    material: Array  # (Q,) uint8
    color: Float32  # (Q, 3)

    def paint(self, color: Array) -> "Quads":
        """Give each a color, (Q, 3)."""
        return replace(self, color=np.asarray(color, np.float32))

    def on_wall(self, yaw_rad: float, foot_m: Three = (0.0, 0.0, 0.0)) -> "Quads":
        """Put them on the wall that stands on `foot_m` (its u = v = d = 0) and looks towards `yaw_rad`."""
        cos, sin = float(np.cos(yaw_rad)), float(np.sin(yaw_rad))
        u, v, d = (self.corners_m[..., i] for i in range(3))
        corners = np.stack([d * cos - u * sin, d * sin + u * cos, v], axis=-1) + np.asarray(foot_m)
        return replace(self, corners_m=corners)

    def mesh(self) -> Mesh:
        """Turn them into a mesh."""
        first = np.arange(len(self.corners_m), dtype=np.int32)[:, None, None] * 4
        triangles = (first + np.array([[0, 1, 2], [0, 2, 3]], np.int32)).reshape(-1, 3)
        vertices, lamp = self.corners_m.reshape(-1, 3).astype(np.float32), np.full(len(triangles), -1, np.int32)
        return Mesh(vertices, triangles, np.repeat(self.material, 2), np.repeat(self.color, 2, axis=0), lamp)


def upright(u0: Number, u1: Number, v0: Number, v1: Number, d: Number, skin: Skin) -> Quads:
    """Return rectangles that look outwards."""
    return _quads([(u0, v0, d), (u1, v0, d), (u1, v1, d), (u0, v1, d)], skin)


def above(u0: Number, u1: Number, d0: Number, d1: Number, v: Number, skin: Skin) -> Quads:
    """Return rectangles that look up."""
    return _quads([(u0, v, d1), (u1, v, d1), (u1, v, d0), (u0, v, d0)], skin)


def below(u0: Number, u1: Number, d0: Number, d1: Number, v: Number, skin: Skin) -> Quads:
    """Return rectangles that look down."""
    return _quads([(u0, v, d0), (u1, v, d0), (u1, v, d1), (u0, v, d1)], skin)


def rightward(v0: Number, v1: Number, d0: Number, d1: Number, u: Number, skin: Skin) -> Quads:
    """Return rectangles that look to the right."""
    return _quads([(u, v0, d1), (u, v0, d0), (u, v1, d0), (u, v1, d1)], skin)


def leftward(v0: Number, v1: Number, d0: Number, d1: Number, u: Number, skin: Skin) -> Quads:
    """Return rectangles that look to the left."""
    return _quads([(u, v0, d0), (u, v0, d1), (u, v1, d1), (u, v1, d0)], skin)


def blocks(
    u0: Number, u1: Number, v0: Number, v1: Number, d0: Number, d1: Number, skin: Skin, back: bool = True
) -> Quads:
    """Return boxes; without `back`, their sides towards the wall are left out."""
    sides = [
        upright(u0, u1, v0, v1, d1, skin),
        above(u0, u1, d0, d1, v1, skin),
        below(u0, u1, d0, d1, v0, skin),
        rightward(v0, v1, d0, d1, u1, skin),
        leftward(v0, v1, d0, d1, u0, skin),
    ]
    if back:
        sides.append(_quads([(u1, v0, d0), (u0, v0, d0), (u0, v1, d0), (u1, v1, d0)], skin))
    return join_quads(sides)


def join_quads(parts: Sequence[Quads]) -> Quads:
    """Join quadrilaterals, in their order."""
    none = Quads(np.zeros((0, 4, 3)), np.zeros(0, np.uint8), np.zeros((0, 3), np.float32))
    names = (field.name for field in fields(Quads))
    return Quads(*(np.concatenate([getattr(p, name) for p in (none, *parts)]) for name in names))


def _quads(corners: Sequence[tuple[Number, Number, Number]], skin: Skin) -> Quads:
    sizes = {x.size for corner in corners for x in corner if isinstance(x, np.ndarray)}
    num = 1 if not sizes else 0 if 0 in sizes else max(sizes)
    points = np.empty((num, len(corners), 3))
    for i, corner in enumerate(corners):
        for k in range(3):
            points[:, i, k] = corner[k]
    color = np.full((num, 3), skin.color, np.float32)
    return Quads(points, np.full(num, INDEX[skin.material], np.uint8), color)
