"""The static world's mesh: everything that a layout names."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from fbench.datasets.city.mesh import Mesh, merged
from fbench.datasets.city.scenery.buildings import building
from fbench.datasets.city.scenery.copies import copies
from fbench.datasets.city.scenery.ground import ground
from fbench.datasets.city.scenery.plants import SPECIES, bush, tree
from fbench.datasets.city.scenery.roadside import barrier, fence, gantry
from fbench.datasets.city.scenery.signals import signal
from fbench.datasets.city.scenery.signs import KINDS, sign
from fbench.datasets.city.scenery.street import bench, bin_, hydrant, lamp_post
from fbench.datasets.city.shapes import Three
from fbench.datasets.city.world.layout import Kind, Layout, Placement
from fbench.replay.draws import generator

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
        mesh = _shrunk(kind, made, size)
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


def _shrunk(kind: Kind, mesh: Mesh, size_lwh_m: Three) -> Mesh:
    """Scale a thing down along the axes in which its box is too small for it."""
    reach = np.abs(mesh.vertices_m.astype(np.float64)).max(axis=0)
    allowed = np.asarray(size_lwh_m) * np.array([1.0 if kind == "lamp_post" else 0.5, 0.5, 1.0])
    vertices = (mesh.vertices_m * np.minimum(1.0, allowed / reach)).astype(np.float32)
    return Mesh(vertices, mesh.triangles, mesh.material, mesh.color, mesh.lamp)


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
