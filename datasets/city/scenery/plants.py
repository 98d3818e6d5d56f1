"""Trees and bushes: dark cores with many leaf clusters around them."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from fbench.datasets.city.mesh import Mesh, Rgb, Skin, Three, cylinder, loft, merged, mesh
from fbench.replay.data.arrays import Array, Float32, Float64

Blob: TypeAlias = tuple[Three, Three]
"""An ellipsoid's centre and radii."""
SPECIES = 4
_LEAVES: tuple[Rgb, ...] = ((0.062, 0.115, 0.028), (0.075, 0.12, 0.03), (0.028, 0.065, 0.028), (0.085, 0.125, 0.035))
_BARK: Rgb = (0.11, 0.085, 0.06)


def tree(species: int, num_leaves: int, rng: np.random.Generator) -> Mesh:
    """Return a tree in a box of 1 x 1 x 1: round, tall, a conifer, or spreading.

    Args:
        species: 0 to 3.
        num_leaves: about how many clusters of leaves it has.
        rng: where its looks come from.
    """
    blobs, foot = _crown_blobs(species, rng)
    leaves = _within(_foliage(blobs, num_leaves, 3.4 / np.sqrt(num_leaves), _LEAVES[species], 0.5, rng), foot)
    trunk = [_trunk(foot + 0.18 if species != 2 else 0.6)]
    if species in (0, 3):
        trunk += [_branch(foot, rng) for _ in range(2)]
    return merged([*trunk, leaves])


def bush(rng: np.random.Generator) -> Mesh:
    """Return a bush in a box of 1 x 1 x 1."""
    blobs: list[Blob] = [((float(x), float(y), 0.45), (0.34, 0.34, 0.5)) for x, y in rng.uniform(-0.15, 0.15, (3, 2))]
    return _within(_foliage(blobs, 70, 0.29, _LEAVES[int(rng.integers(3))], 1.0, rng), 0.0)


def _crown_blobs(species: int, rng: np.random.Generator) -> tuple[list[Blob], float]:
    """Ellipsoids of a crown, and how high above the foot it begins."""
    if species == 2:  # layers of a cone
        levels = np.linspace(0.0, 1.0, 7)[:-1]
        return [((0.0, 0.0, float(0.12 + 0.82 * t)), (float(0.5 - 0.46 * t),) * 2 + (0.1,)) for t in levels], 0.08
    if species == 1:
        return [((0.0, 0.0, 0.45), (0.46, 0.46, 0.32)), ((0.05, -0.04, 0.72), (0.34, 0.34, 0.28))], 0.14
    num, spread, foot = (5, 0.2, 0.26) if species == 0 else (6, 0.28, 0.3)
    angle = np.arange(num) * 2.4 + rng.uniform(0, 6.28)
    radius = spread * np.sqrt((np.arange(num) + 0.5) / num)
    height = np.linspace(0.78, 0.5, num) + rng.uniform(-0.05, 0.05, num)
    size = rng.uniform(0.22, 0.32, num)
    return [((float(r * np.cos(a)), float(r * np.sin(a)), float(z)), (float(s), float(s), float(0.75 * s)))
            for a, r, z, s in zip(angle, radius, height, size, strict=True)], foot  # fmt: skip


def _foliage(blobs: Sequence[Blob], num: int, size: float, color: Rgb, squash: float, rng: np.random.Generator) -> Mesh:
    """About `num` clusters of leaves around blobs; `squash` makes up for what stretches them upwards later."""
    cores = [_core(center, radii, color, rng) for center, radii in blobs]
    points, normals = _on_surface(blobs, num, rng)
    low, high = points[:, 2].min(), points[:, 2].max()
    up = (points[:, 2] - low) / (high - low)
    sizes = size * rng.uniform(0.7, 1.25, (len(points), 1))
    return merged([*cores, _cards(points, normals, sizes, color, up, squash, rng)])


def _on_surface(blobs: Sequence[Blob], num: int, rng: np.random.Generator) -> tuple[Float64, Float64]:
    """Points on ellipsoids that lie in no other, about `num`, and the directions outwards."""
    centers, radii = np.array([b[0] for b in blobs]), np.array([b[1] for b in blobs])
    weight = radii[:, 0] * (radii[:, 0] + radii[:, 2])
    which = rng.choice(len(blobs), 3 * num, p=weight / weight.sum())
    direction = rng.standard_normal((3 * num, 3))
    direction /= np.sqrt((direction * direction).sum(axis=1, keepdims=True))
    points = centers[which] + radii[which] * direction * rng.uniform(0.88, 1.06, (3 * num, 1))
    away = (points[:, None] - centers[None]) / radii[None]
    free = ((away * away).sum(axis=2) > 0.7).all(axis=1)
    normals = direction / radii[which]
    normals /= np.sqrt((normals * normals).sum(axis=1, keepdims=True))
    return points[free][:num], normals[free][:num]


def _cards(
    points: Float64, normals: Float64, sizes: Float64, color: Rgb, up: Array, squash: float, rng: np.random.Generator
) -> Mesh:
    """Clusters of leaves: triangles about `normals`, tilted at random, brighter where they are higher up (0 to 1)."""
    num = len(points)
    normals = normals + rng.normal(0.0, 0.38, (num, 3))
    normals /= np.sqrt((normals * normals).sum(axis=1, keepdims=True))
    u = np.cross(normals, rng.standard_normal((num, 3)))
    u /= np.sqrt((u * u).sum(axis=1, keepdims=True))
    v = np.cross(normals, u)
    turn = rng.uniform(-0.35, 0.35, (num, 3)) + np.arange(3) * (2 * np.pi / 3)
    reach = 0.62 * sizes * rng.uniform(0.75, 1.25, (num, 3))
    cos, sin = np.cos(turn)[..., None], np.sin(turn)[..., None]
    away = reach[..., None] * (cos * u[:, None] + sin * v[:, None]) * np.array([1.0, 1.0, squash])
    corners = points[:, None] + away
    whole = mesh(corners.reshape(-1, 3), np.arange(3 * num).reshape(-1, 3), Skin("foliage", color))
    light = (0.62 + 0.5 * up) * rng.uniform(0.75, 1.25, num)
    hue = 1.0 + rng.normal(0.0, 0.07, (num, 3)) * np.array([1.0, 0.4, 1.0])
    return _colored(whole, np.asarray(color) * light[:, None] * hue)


def _core(center: Three, radii: Three, color: Rgb, rng: np.random.Generator) -> Mesh:
    """A dark, uneven ball within a blob, so that little shines through the leaves."""
    num = 6
    angle = np.arange(num) * (2 * np.pi / num)
    rings = []
    for tilt in np.radians((-60.0, 0.0, 60.0)):
        r = np.cos(tilt) * rng.uniform(0.72, 0.9, num)
        rings.append(np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(num, 0.86 * np.sin(tilt))])
                     * np.asarray(radii) + np.asarray(center))  # fmt: skip
    return loft(rings, _dark(color))


def _dark(color: Rgb) -> Skin:
    r, g, b = color
    return Skin("foliage", (0.45 * r, 0.45 * g, 0.45 * b))


def _trunk(top: float) -> Mesh:
    angle = np.arange(7) * (2 * np.pi / 7)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(7)])
    radii, heights = (0.05, 0.034, 0.028, 0.014), (0.0, 0.04, 0.5 * top, top)
    return loft([ring * r + np.array([0, 0, z]) for r, z in zip(radii, heights, strict=True)], Skin("bark", _BARK))


def _branch(foot: float, rng: np.random.Generator) -> Mesh:
    a = float(rng.uniform(0, 2 * np.pi))
    end = (0.2 * float(np.cos(a)), 0.2 * float(np.sin(a)), foot + 0.2)
    return cylinder((0.0, 0.0, foot * 0.85), end, 0.016, 5, Skin("bark", _BARK), 0.008)


def _within(leaves: Mesh, foot: float) -> Mesh:
    """Stretch leaves so that they fill the unit box from `foot` to 1."""
    v = leaves.vertices_m.astype(np.float64)
    low, high = v.min(axis=0), v.max(axis=0)
    size = np.array([1.0, 1.0, 1.0 - foot])
    fitted = (v - low) / (high - low) * size + np.array([-0.5, -0.5, foot])
    return Mesh(fitted.astype(np.float32), leaves.triangles, leaves.material, leaves.color, leaves.lamp)


def _colored(whole: Mesh, color: Array) -> Mesh:
    albedo: Float32 = np.clip(color, 0.0, 1.0).astype(np.float32)
    return Mesh(whole.vertices_m, whole.triangles, whole.material, albedo, whole.lamp)
