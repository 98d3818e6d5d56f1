"""The static world's mesh: everything that a layout names."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from fbench.datasets.city.mesh import Mesh, Three, merged
from fbench.datasets.city.scenery.buildings import building
from fbench.datasets.city.scenery.ground import ground
from fbench.datasets.city.scenery.plants import SPECIES, bush, tree
from fbench.datasets.city.scenery.roadside import KINDS, barrier, fence, gantry, sign
from fbench.datasets.city.scenery.street import bench, bin_, hydrant, lamp_post, signal
from fbench.datasets.city.world.city_map import Kind, Layout, Placement
from fbench.replay.conditions.generators import generator
from fbench.replay.data.arrays import Array, Float64


def copies(
    mesh: Mesh, position_m: Float64, yaw_rad: Float64, scale: Float64, tint: Float64, lamp_base: Array | None = None
) -> Mesh:
    """Place N copies of a mesh.

    Args:
        mesh: in its own coordinates, x forward, z up.
        position_m: (N, 3) where its origin comes to lie.
        yaw_rad: (N,) about z.
        scale: (N, 3) along its own axes, applied first; positive.
        tint: (N, 3) factors on its colours, of which none exceeds 1 afterwards.
        lamp_base: (N,) what is added to the numbers of its lamps; -1: this copy's lamps can't be switched.
    """
    num = len(position_m)
    cos, sin = np.cos(yaw_rad)[:, None], np.sin(yaw_rad)[:, None]
    own = mesh.vertices_m[None].astype(np.float64) * scale[:, None]
    x, y = own[..., 0], own[..., 1]
    moved = np.stack([x * cos - y * sin, x * sin + y * cos, own[..., 2]], axis=-1) + position_m[:, None]
    first = np.arange(num, dtype=np.int32)[:, None, None] * len(mesh.vertices_m)
    colors = np.minimum(mesh.color[None] * tint[:, None], 1.0).astype(np.float32)
    return Mesh(
        moved.reshape(-1, 3).astype(np.float32),
        (mesh.triangles[None] + first).reshape(-1, 3).astype(np.int32),
        np.tile(mesh.material, num),
        colors.reshape(-1, 3),
        _lamps(mesh.lamp, np.zeros(num, np.int32) if lamp_base is None else lamp_base),
    )


def _lamps(lamp: Array, base: Array) -> Array:
    own = (lamp[None] >= 0) & (base[:, None] >= 0)
    return np.where(own, lamp[None] + base[:, None], -1).astype(np.int32).reshape(-1)


Make: TypeAlias = Callable[[Three, int, np.random.Generator], Mesh]
"""From size, look and random numbers to a mesh in its own coordinates."""
_MAX_LEAVES, _ALL_LEAVES = 320, 70_000
"""Clusters of leaves of a tree, and of all of them together: a forest has coarser ones."""
_UNIT: Three = (1.0, 1.0, 1.0)
_LOOKS: dict[Kind, int] = {
    "tree": 3 * SPECIES, "bush": 4, "lamp_post": 1, "signal": 1, "sign": len(KINDS), "bench": 1, "bin": 3,
    "hydrant": 1, "barrier": 1, "gantry": 4, "fence": 1,
}  # fmt: skip
"""How many variants differ; buildings are each like no other."""
_MAKERS: dict[Kind, Make] = {
    "building": lambda size, look, rng: building(size, rng),
    "bush": lambda size, look, rng: bush(rng),
    "lamp_post": lambda size, look, rng: lamp_post(size),
    "signal": lambda size, look, rng: signal(size),
    "sign": lambda size, look, rng: sign(size, KINDS[look]),
    "bench": lambda size, look, rng: bench(size),
    "bin": lambda size, look, rng: bin_(size, rng),
    "hydrant": lambda size, look, rng: hydrant(size),
    "barrier": lambda size, look, rng: barrier(size),
    "gantry": lambda size, look, rng: gantry(size, rng),
    "fence": lambda size, look, rng: fence(size, rng),
}


def scenery(layout: Layout, seed: int) -> Mesh:
    """Return everything that stands or lies in a world, in its coordinates.

    Every thing stays within the box of its placement; buildings fill it. Things of one kind, size (to 1 cm) and variant
    share their shape. Lamps of signals bear the numbers 3 * group + 0 red, 1 yellow, 2 green; all else bears -1.
    """
    groups: dict[tuple[Kind, Three, int], list[int]] = defaultdict(list)
    for i, placement in enumerate(layout.placements):
        groups[_look(placement, i)].append(i)
    num_trees = sum(placement.kind == "tree" for placement in layout.placements)
    num_leaves = min(_MAX_LEAVES, _ALL_LEAVES // max(num_trees, 1))
    parts = [ground(layout.patches)]
    for (kind, size, look), indices in groups.items():
        rng = generator(seed, "scenery", kind, look)
        made = tree(look % SPECIES, num_leaves, rng) if kind == "tree" else _MAKERS[kind](size, look, rng)
        reach = np.abs(made.vertices_m.astype(np.float64)).max(axis=0)
        allowed = np.asarray(size) * np.array([1.0 if kind == "lamp_post" else 0.5, 0.5, 1.0])
        vertices = (made.vertices_m * np.minimum(1.0, allowed / reach)).astype(np.float32)
        mesh = Mesh(vertices, made.triangles, made.material, made.color, made.lamp)
        parts.append(_placed(mesh, [layout.placements[i] for i in indices], size, rng))
    return merged(parts)


def _look(placement: Placement, index: int) -> tuple[Kind, Three, int]:
    """What two placements have in common that share a shape."""
    kind, size = placement.kind, placement.size_lwh_m
    if kind == "building":
        return kind, size, index * 1000 + placement.variant % 1000
    if kind in ("tree", "bush"):
        size = _UNIT
    size = (round(size[0], 2), round(size[1], 2), round(size[2], 2))
    return kind, size, placement.variant % _LOOKS[kind]


def _placed(mesh: Mesh, placements: Sequence[Placement], size: Three, rng: np.random.Generator) -> Mesh:
    num = len(placements)
    sizes = np.array([p.size_lwh_m for p in placements])
    is_plant = placements[0].kind in ("tree", "bush")
    light = rng.uniform(0.8, 1.25, (num, 1)) * rng.uniform(0.9, 1.1, (num, 3)) if is_plant else np.ones((num, 3))
    return copies(
        mesh,
        np.array([p.position_m for p in placements]),
        np.array([p.yaw_rad for p in placements]),
        sizes / np.asarray(size),
        light,
        np.array([-1 if p.signal is None else 3 * p.signal for p in placements], np.int32),
    )
