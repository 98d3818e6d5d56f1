"""The static world's mesh: everything that a layout names, and its plants."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from fbench.datasets.city.mesh import Mesh, Rgb, Skin, Three, cylinder, loft, merge_meshes, mesh
from fbench.datasets.city.scenery import roadside
from fbench.datasets.city.scenery.buildings import building
from fbench.datasets.city.scenery.ground import ground
from fbench.datasets.city.world.city_map import Kind, Layout, Placement
from fbench.replay.conditions.generators import generator
from fbench.replay.data.arrays import Array, Float64

Blob: TypeAlias = tuple[Three, Three]  # An ellipsoid's center and radii
SPECIES = 4
_LEAVES: tuple[Rgb, ...] = ((0.062, 0.115, 0.028), (0.075, 0.12, 0.03), (0.028, 0.065, 0.028), (0.085, 0.125, 0.035))
_BARK: Rgb = (0.11, 0.085, 0.06)


def tree(species: int, num_leaves: int, rng: np.random.Generator) -> Mesh:
    """Return a tree in a box of 1 x 1 x 1: round, tall, a conifer, or spreading. `species` is 0 to 3, `num_leaves`
    about how many clusters of leaves it has.
    """
    blobs, foot = _crown_blobs(species, rng)
    leaves = _within(_foliage(blobs, num_leaves, 3.4 / np.sqrt(num_leaves), _LEAVES[species], 0.5, rng), foot)
    angle, top, bark = np.arange(7) * (2 * np.pi / 7), foot + 0.18 if species != 2 else 0.6, Skin("bark", _BARK)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(7)])
    radii = ((0.05, 0.0), (0.034, 0.04), (0.028, 0.5 * top), (0.014, top))
    trunk = [loft([ring * r + np.array([0, 0, z]) for r, z in radii], bark)]
    for _ in range(2 if species in (0, 3) else 0):
        a = float(rng.uniform(0, 2 * np.pi))
        end = (0.2 * float(np.cos(a)), 0.2 * float(np.sin(a)), foot + 0.2)
        trunk.append(cylinder((0.0, 0.0, foot * 0.85), end, 0.016, 5, bark, 0.008))
    return merge_meshes([*trunk, leaves])


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
    """About `num` clusters of leaves around blobs; `squash` makes up for what stretches them upwards later. In each
    blob is a dark, uneven ball, so that little shines through; leaves are where it lies in no other blob.
    """
    angle, (red, green, blue) = np.arange(6) * (2 * np.pi / 6), color
    dark, cores = Skin("foliage", (0.45 * red, 0.45 * green, 0.45 * blue)), []
    for center, radius in blobs:
        rings = []
        for tilt in np.radians((-60.0, 0.0, 60.0)):
            r = np.cos(tilt) * rng.uniform(0.72, 0.9, 6)
            ring = np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(6, 0.86 * np.sin(tilt))])
            rings.append(ring * np.asarray(radius) + np.asarray(center))
        cores.append(loft(rings, dark))
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
    points, normals = points[free][:num], normals[free][:num]
    low, high = points[:, 2].min(), points[:, 2].max()
    sizes = size * rng.uniform(0.7, 1.25, (len(points), 1))
    return merge_meshes(
        [*cores, _cards(points, normals, sizes, color, (points[:, 2] - low) / (high - low), squash, rng)]
    )


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
    corners = (points[:, None] + away).reshape(-1, 3)
    light = (0.62 + 0.5 * up) * rng.uniform(0.75, 1.25, num)
    hue = 1.0 + rng.normal(0.0, 0.07, (num, 3)) * np.array([1.0, 0.4, 1.0])
    albedo = np.clip(np.asarray(color) * light[:, None] * hue, 0.0, 1.0).astype(np.float32)
    return replace(mesh(corners, np.arange(3 * num).reshape(-1, 3), Skin("foliage", color)), color=albedo)


def _within(leaves: Mesh, foot: float) -> Mesh:
    """Stretch leaves so that they fill the unit box from `foot` to 1."""
    v = leaves.vertices_m.astype(np.float64)
    low, high = v.min(axis=0), v.max(axis=0)
    fitted = (v - low) / (high - low) * np.array([1.0, 1.0, 1.0 - foot]) + np.array([-0.5, -0.5, foot])
    return replace(leaves, vertices_m=fitted.astype(np.float32))


Make: TypeAlias = Callable[[Three, int, np.random.Generator], Mesh]
"""From size, look and random numbers to a mesh in its own coordinates."""
_MAX_LEAVES, _ALL_LEAVES = 320, 70_000
"""Clusters of leaves of a tree, and of all of them together: a forest has coarser ones."""
_LOOKS: dict[Kind, int] = {
    "tree": 3 * SPECIES, "bush": 4, "lamp_post": 1, "signal": 1, "sign": len(roadside.KINDS), "bench": 1, "bin": 3,
    "hydrant": 1, "barrier": 1, "gantry": 4, "fence": 1,
}  # fmt: skip
"""How many variants differ; buildings are each like no other."""
_MAKERS: dict[Kind, Make] = {
    "building": lambda size, look, rng: building(size, rng),
    "bush": lambda size, look, rng: bush(rng),
    "lamp_post": lambda size, look, rng: roadside.lamp_post(size),
    "signal": lambda size, look, rng: roadside.signal(size),
    "sign": lambda size, look, rng: roadside.sign(size, roadside.KINDS[look]),
    "bench": lambda size, look, rng: roadside.bench(size),
    "bin": lambda size, look, rng: roadside.bin_(size, rng),
    "hydrant": lambda size, look, rng: roadside.hydrant(size),
    "barrier": lambda size, look, rng: roadside.barrier(size),
    "gantry": lambda size, look, rng: roadside.gantry(size, rng),
    "fence": lambda size, look, rng: roadside.fence(size, rng),
}


def scenery(layout: Layout, seed: int) -> Mesh:
    """Return everything that stands or lies in a world, in its coordinates. Every thing stays within the box of its
    placement; buildings fill it. Things of one kind, size (to 1 cm) and variant share their shape. Lamps of signals
    bear the numbers 3 * group + 0 red, 1 yellow, 2 green; all else bears -1.
    """
    groups: dict[tuple[Kind, Three, int], list[Placement]] = defaultdict(list)
    for i, placement in enumerate(layout.placements):
        kind, size = placement.kind, placement.size_lwh_m
        look = i * 1000 + placement.variant % 1000 if kind == "building" else placement.variant % _LOOKS[kind]
        if kind in ("tree", "bush"):
            size = (1.0, 1.0, 1.0)
        elif kind != "building":
            size = (round(size[0], 2), round(size[1], 2), round(size[2], 2))
        groups[kind, size, look].append(placement)
    num_trees = sum(placement.kind == "tree" for placement in layout.placements)
    num_leaves = min(_MAX_LEAVES, _ALL_LEAVES // max(num_trees, 1))
    parts = [ground(layout.patches)]
    for (kind, size, look), placements in groups.items():
        rng = generator(seed, "scenery", kind, look)
        made = tree(look % SPECIES, num_leaves, rng) if kind == "tree" else _MAKERS[kind](size, look, rng)
        reach = np.abs(made.vertices_m.astype(np.float64)).max(axis=0)
        allowed = np.asarray(size) * np.array([1.0 if kind == "lamp_post" else 0.5, 0.5, 1.0])
        vertices = (made.vertices_m * np.minimum(1.0, allowed / reach)).astype(np.float32)
        parts.append(_place(replace(made, vertices_m=vertices), placements, size, rng))
    return merge_meshes(parts)


def _place(mesh: Mesh, placements: Sequence[Placement], size: Three, rng: np.random.Generator) -> Mesh:
    """Place copies of a mesh (x forward, z up, in a box of `size`), each scaled along its own axes to its placement;
    plants differ in their colors, of which none exceeds 1. Lamps of what isn't a signal can't be switched.
    """
    num = len(placements)
    light = np.ones((num, 3))
    if placements[0].kind in ("tree", "bush"):
        light = rng.uniform(0.8, 1.25, (num, 1)) * rng.uniform(0.9, 1.1, (num, 3))
    scale = np.array([p.size_lwh_m for p in placements]) / np.asarray(size)
    position, yaw = np.array([p.position_m for p in placements]), np.array([p.yaw_rad for p in placements])[:, None]
    base = np.array([-1 if p.signal is None else 3 * p.signal for p in placements], np.int32)[:, None]
    own = mesh.vertices_m[None].astype(np.float64) * scale[:, None]
    x, y, cos, sin = own[..., 0], own[..., 1], np.cos(yaw), np.sin(yaw)
    moved = np.stack([x * cos - y * sin, x * sin + y * cos, own[..., 2]], axis=-1) + position[:, None]
    first = np.arange(num, dtype=np.int32)[:, None, None] * len(mesh.vertices_m)
    lamps = np.where((mesh.lamp[None] >= 0) & (base >= 0), mesh.lamp[None] + base, -1)
    return Mesh(
        moved.reshape(-1, 3).astype(np.float32),
        (mesh.triangles[None] + first).reshape(-1, 3).astype(np.int32),
        np.tile(mesh.material, num),
        np.minimum(mesh.color[None] * light[:, None], 1.0).astype(np.float32).reshape(-1, 3),
        lamps.astype(np.int32).reshape(-1),
    )
