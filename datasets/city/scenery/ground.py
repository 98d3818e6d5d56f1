"""The ground: patches of road, sidewalk and marking, triangulated, and grass to the horizon."""

from collections.abc import Sequence

import numpy as np

from fbench.datasets.city.mesh import INDEX, Mesh, Rgb, Skin, merge_meshes, mesh, quad, scale_color
from fbench.datasets.city.scenery.quads import Quads, join_quads
from fbench.datasets.city.world.city_map import GROUND_Z_M, Patch
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Array, Bool, Float64

_STRAIGHT_M = 1e-4  # A point so near the line between its neighbors that it only makes slivers


def surface(points_m: Float64) -> tuple[Float64, Array]:
    """Cut a simple polygon (P, 2), counter-clockwise, into triangles: its outline (Q, 2) and indices of it (T, 3).

    Points that lie on straight lines may be left out of the outline. Strips, whose points lie in pairs on both sides,
    are cut across; of other concave polygons the least slender ear goes first, which keeps slivers away. Raises
    ConfigError where the outline crosses itself or runs clockwise.
    """
    strip = _strip(points_m)
    if strip is not None:
        return points_m, strip
    outline = _simplify(points_m)
    if is_convex(outline):
        num = len(outline)
        return outline, np.column_stack([np.zeros(num - 2, np.int64), np.arange(1, num - 1), np.arange(2, num)])
    return outline, _Clipping(outline).triangles()


def is_convex(points_m: Float64) -> Bool:
    """Return which outlines (..., P, 2), counter-clockwise, are convex, with no point on a straight line."""
    before, after = np.roll(points_m, 1, axis=-2), np.roll(points_m, -1, axis=-2)
    return np.asarray((_cross(before, points_m, after) > _STRAIGHT_M**2).all(axis=-1))


def _strip(points: Float64) -> Array | None:
    """Triangles of a strip: all its quadrilaterals, each between two points of a side and those opposite, are convex.
    Where that holds of a simple outline they can't overlap: it would wind around some place twice.
    """
    num = len(points)
    if num < 6 or num % 2:
        return None
    i = np.arange(num // 2 - 1)
    quads = np.column_stack([i, i + 1, num - 2 - i, num - 1 - i])
    if not is_convex(points[quads]).all():
        return None
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _simplify(points_m: Float64) -> Float64:
    """Leave out points of an outline (P, 2) that repeat others or lie on straight lines."""
    points = points_m
    while len(points) > 3:
        before, after = np.roll(points, 1, axis=0), np.roll(points, -1, axis=0)
        chord = np.hypot(*(after - before).T)
        offset = np.abs(_cross(before, points, after)) / np.maximum(chord, 1e-9)
        useless = (offset < _STRAIGHT_M) | (np.hypot(*(points - before).T) < _STRAIGHT_M)
        useless &= ~np.roll(useless, 1) | (np.arange(len(points)) % 2 == 0)  # never a whole run at once
        if not useless.any():
            break
        points = points[~useless]
    return points


class _Clipping:
    """What is left of a polygon while its ears are cut off."""

    def __init__(self, points_m: Float64) -> None:
        num = len(points_m)
        self.points = points_m
        self.before, self.after = np.roll(np.arange(num), 1), np.roll(np.arange(num), -1)
        self.left = np.ones(num, bool)
        self.reflex = _cross(points_m[self.before], points_m, points_m[self.after]) <= 0
        self.quality = np.full(num, -1.0)

    def triangles(self) -> Array:
        """Cut the best ear off, again and again; where none is known, look at all that is left once more."""
        triangles = np.empty((len(self.points) - 2, 3), np.int64)
        for k in range(len(triangles)):
            i = int(self.quality.argmax())
            if self.quality[i] <= 0:
                for j in np.flatnonzero(self.left).tolist():
                    self.quality[j] = self._ear_quality(j)
                i = int(self.quality.argmax())
            if self.quality[i] <= 0:
                place = self.points[i].tolist()
                raise ConfigError(f"outline of a patch near {place} crosses itself; correct the layout")
            a, b = int(self.before[i]), int(self.after[i])
            self.left[i], self.reflex[i], self.quality[i] = False, False, -1.0
            self.after[a], self.before[b] = b, a
            for j in (a, b):
                self.reflex[j] = self._turn(j) <= 0
            for j in (a, b):
                self.quality[j] = self._ear_quality(j)
            triangles[k] = a, i, b
        return triangles

    def _turn(self, i: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = (self.points[j].tolist() for j in (self.before[i], i, self.after[i]))
        return float((bx - ax) * (cy - by) - (by - ay) * (cx - bx))

    def _ear_quality(self, i: int) -> float:
        """Twice the triangle's area by its longest side squared; -1 where it is no ear."""
        turn = self._turn(i)
        if turn <= 0:
            return -1.0
        near = (self.before[i], i, self.after[i])
        a, b, c = (self.points[j] for j in near)
        others = self.reflex.copy()
        others[list(near)] = False
        p = self.points[others]
        if ((_cross(a, b, p) >= 0) & (_cross(b, c, p) >= 0) & (_cross(c, a, p) >= 0)).any():
            return -1.0
        return turn / float(max(((b - a) ** 2).sum(), ((c - b) ** 2).sum(), ((a - c) ** 2).sum()))


def _cross(a: Float64, b: Float64, c: Float64) -> Float64:
    """Twice the signed areas of triangles: positive where c lies to the left of the way from a to b."""
    (u, v), (p, q) = ((end[..., 0] - a[..., 0], end[..., 1] - a[..., 1]) for end in (b, c))
    return np.asarray(u * q - v * p, np.float64)


GROUND_SIDE_M = 4000.0
COLORS: dict[str, Rgb] = {
    "asphalt": (0.085, 0.085, 0.09),
    "marking": (0.72, 0.72, 0.7),
    "sidewalk": (0.3, 0.29, 0.275),
    "grass": (0.07, 0.125, 0.035),
    "soil": (0.14, 0.1, 0.065),
    "concrete": (0.33, 0.32, 0.3),
}
"""Albedo, linear: asphalt and grass as published for dry road surfaces and lawns, the rest by eye."""
_OTHER, _KERB = (0.3, 0.3, 0.3), (0.4, 0.39, 0.37)


def ground(patches: Sequence[Patch]) -> Mesh:
    """Return all patches, seen from above, with the sides of kerbs, and the ground plane around their middle."""
    points = np.concatenate([np.zeros((0, 2)), *(patch.points_m for patch in patches)])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2 if len(points) else np.zeros(2)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (GROUND_SIDE_M / 2) + middle
    plane = quad(np.column_stack([corners, np.full(4, GROUND_Z_M)]), Skin("grass", COLORS["grass"]))
    quads, kerbs, others, other_kerbs = list[Quads](), list[Quads](), list[Mesh](), list[Quads]()
    for patch in patches:
        outline, z_m = patch.points_m, patch.z_m
        skin = Skin(patch.material, scale_color(COLORS.get(patch.material, _OTHER), patch.shade))
        simple = len(outline) == 4 and bool(is_convex(outline))
        if simple:
            flat = np.column_stack([outline, np.full(4, z_m)])[None]
            quads.append(Quads(flat, np.array([INDEX[skin.material]], np.uint8), np.array([skin.color], np.float32)))
        else:
            outline, triangles = surface(outline)
            others.append(mesh(np.column_stack([outline, np.full(len(outline), z_m)]), triangles, skin))
        if patch.has_kerb:
            (kerbs if simple else other_kerbs).append(_kerb(z_m, outline))
    walls = join_quads([*kerbs, *other_kerbs]).mesh()
    return merge_meshes([plane, join_quads(quads).mesh(), *others, walls])


def _kerb(z_m: float, outline: Float64) -> Quads:
    """Walls from 0 up to a patch along its whole outline."""
    nearest, num = np.roll(outline, -1, axis=0), len(outline)
    low, high = np.zeros(num), np.full(num, z_m)
    corners = [np.column_stack([p, z]) for p, z in ((outline, low), (nearest, low), (nearest, high), (outline, high))]
    color = np.tile(np.asarray(_KERB, np.float32), (num, 1))
    return Quads(np.stack(corners, axis=1), np.full(num, INDEX["concrete"], np.uint8), color)
