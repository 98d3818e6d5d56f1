"""Everything that stands keeps to its box, is sound as a mesh and depends on nothing but layout and seed."""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from fbench.datasets.city.mesh import INDEX, Mesh, Three
from fbench.datasets.city.scenery.scenery import scenery
from fbench.datasets.city.world.city_map import Kind, Layout, Patch, Placement
from fbench.datasets.city.world.urban import layout
from fbench.replay.data.arrays import Array, Float64

Make = Callable[[list[Patch], list[Placement]], Layout]
NUM_GROUND = 2
SIZES: dict[Kind, list[Three]] = {
    "building": [(12, 15, 14), (10, 8, 7), (14, 22, 31), (30, 40, 9), (5, 6, 12), (11, 3, 20), (8, 30, 17)],
    "tree": [(5, 5, 9), (3, 3, 8)],
    "bush": [(1.2, 1.3, 1)],
    "lamp_post": [(2.2, 0.2, 8), (3, 0.25, 11)],
    "signal": [(0.3, 0.3, 3.4), (0.25, 0.25, 2.6)],
    "sign": [(0.1, 0.6, 2.6), (0.1, 0.9, 2.8)],
    "bench": [(0.45, 1.6, 0.85)],
    "bin": [(0.4, 0.4, 0.9)],
    "hydrant": [(0.3, 0.3, 0.8)],
    "barrier": [(12, 0.3, 0.9), (11.9, 0.25, 0.75), (4, 0.6, 0.75)],
    "gantry": [(0.6, 17, 7.2), (1, 9, 6.5)],
    "fence": [(11, 0.2, 3.5)],
}
CASES = [(kind, size, variant) for kind, sizes in SIZES.items() for size in sizes for variant in range(7)]


def _thing(make_layout: Make, placement: Placement, seed: int = 1) -> Mesh:
    """The mesh of one placement, without the ground."""
    whole = scenery(make_layout([], [placement]), seed)
    keep = slice(NUM_GROUND, None)
    return Mesh(whole.vertices_m, whole.triangles[keep], whole.material[keep], whole.color[keep], whole.lamp[keep])


def _used(mesh: Mesh) -> Float64:
    return mesh.vertices_m.astype(np.float64)[np.unique(mesh.triangles)]


@pytest.mark.parametrize(("kind", "size", "variant"), CASES)
def test_a_thing_is_sound_and_stays_in_its_box(
    make_layout: Make, areas: Callable[[Mesh], Array], kind: Kind, size: Three, variant: int
) -> None:
    mesh = _thing(make_layout, Placement(kind, (0, 0, 0), 0.0, size, variant))
    length, width, height = size
    front = length if kind == "lamp_post" else length / 2
    low, high = _used(mesh).min(axis=0), _used(mesh).max(axis=0)
    assert np.all(low >= np.array([-length / 2, -width / 2, 0]) - 1e-4)
    assert np.all(high <= np.array([front, width / 2, height]) + 1e-4)
    assert high[2] > 0.95 * height
    assert low[2] < 0.01 + 0.1 * (kind == "bush")
    assert np.isfinite(mesh.vertices_m).all()
    assert areas(mesh).min() > 1e-7
    assert mesh.color.min() >= 0
    assert mesh.color.max() <= 1
    assert np.all(mesh.lamp == -1)
    if kind == "building":
        np.testing.assert_allclose(np.concatenate([low, high]), [-length / 2, -width / 2, 0, front, width / 2, height],
                                   atol=0.01)  # fmt: skip


@pytest.mark.parametrize(("kind", "size", "variant"), [c for c in CASES if c[0] not in ("tree", "bush")])
def test_normals_look_outwards(
    make_layout: Make, corners: Callable[[Mesh], Float64], kind: Kind, size: Three, variant: int
) -> None:
    """Parts that share vertices and are closed enclose a positive volume; so do walls and roof together."""
    mesh = _thing(make_layout, Placement(kind, (0, 0, 0), 0.0, size, variant))
    a, b, c = np.moveaxis(corners(mesh), 1, 0)
    signed = (a * np.cross(b, c)).sum(axis=1) / 6
    assert signed.sum() > 0
    for part in _closed_parts(mesh):
        # About its middle, so that how far off it stands doesn't matter.
        middle = np.concatenate([a[part], b[part], c[part]]).mean(axis=0)
        p, q, r = a[part] - middle, b[part] - middle, c[part] - middle
        assert (p * np.cross(q, r)).sum() > 0


def _closed_parts(mesh: Mesh) -> list[Array]:
    """Triangles of every part each of whose edges has two sides."""
    parent = list(range(len(mesh.vertices_m)))

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for a, b, c in mesh.triangles.tolist():
        parent[root(a)] = root(b)
        parent[root(b)] = root(c)
    owner = np.array([root(a) for a in mesh.triangles[:, 0].tolist()])
    parts = [np.flatnonzero(owner == which) for which in np.unique(owner)]
    return [part for part in parts if _is_closed(mesh.triangles[part])]


def _is_closed(triangles: Array) -> bool:
    edges = {(int(t[i]), int(t[(i + 1) % 3])) for t in triangles for i in range(3)}
    return all((b, a) in edges for a, b in edges)


@pytest.mark.parametrize("kind", [kind for kind in SIZES if kind not in ("tree", "bush")])
def test_a_thing_seen_from_anywhere_shows_its_outside(make_layout: Make, kind: Kind) -> None:
    """Rays from afar meet no triangle from behind first, whatever the size and the variant."""
    rng = np.random.default_rng(3)
    for variant in range(7 if kind != "building" else 40):
        size = SIZES[kind][variant % len(SIZES[kind])]
        mesh = _thing(make_layout, Placement(kind, (0, 0, 0), 0.0, size, variant), seed=variant)
        way = rng.standard_normal((400, 3))
        way[:, 2] = np.abs(way[:, 2])
        origin = 80 * way / np.linalg.norm(way, axis=1)[:, None]
        target = _used(mesh)[rng.integers(len(_used(mesh)), size=400)]
        outside = _cosines(mesh, origin, target + rng.normal(0, 0.02, (400, 3))) < 0
        # Guard rails are open at their ends, which the next piece closes; between a wall
        # and what lies just before it, one can look along.
        assert outside.mean() > (0.85 if kind == "barrier" else 0.97)


def _cosines(mesh: Mesh, origin: Float64, target: Float64) -> Array:
    """Of the angles between rays and the normals of what they hit first; of those that hit something."""
    way = target - origin
    way /= np.linalg.norm(way, axis=1)[:, None]
    scene = EmbreeScene()
    kept = TriangleMesh(scene, np.ascontiguousarray(mesh.vertices_m), np.ascontiguousarray(mesh.triangles))
    hit = scene.run(origin.astype(np.float32), way.astype(np.float32))
    del kept
    a, b, c = (mesh.vertices_m[mesh.triangles[hit[hit >= 0]][:, i]].astype(float) for i in range(3))
    normal = np.cross(b - a, c - a)
    cosine: Array = (normal * way[hit >= 0]).sum(axis=1) / np.linalg.norm(normal, axis=1)
    return cosine


@pytest.mark.parametrize(("size", "lamps"), [((0.3, 0.3, 3.4), [15, 16, 17]), ((0.25, 0.25, 2.6), [15, 17])])
def test_lamps_of_a_signal_bear_its_groups_numbers(make_layout: Make, size: Three, lamps: list[int]) -> None:
    mesh = _thing(make_layout, Placement("signal", (3, 4, 0.15), np.pi / 2, size, 0, 5))
    shines = mesh.material == INDEX["signal_lamp"]
    assert np.array_equal(mesh.lamp >= 0, shines)
    assert np.unique(mesh.lamp[shines]).tolist() == lamps
    heights = [mesh.vertices_m[mesh.triangles[mesh.lamp == lamp]][..., 2].mean() for lamp in lamps]
    assert heights == sorted(heights, reverse=True)
    red, green = (mesh.color[mesh.lamp == lamp][0] for lamp in (lamps[0], lamps[-1]))
    assert red[0] > 5 * red[1]
    assert green[1] > 5 * green[0]
    front = mesh.vertices_m[mesh.triangles[shines]][..., 1].mean()
    post = mesh.vertices_m[mesh.triangles[mesh.material == INDEX["pole"]]][..., 1].mean()
    assert front > post  # its front looks to +y


def test_a_thing_stands_where_it_is_placed(make_layout: Make) -> None:
    here = _thing(make_layout, Placement("bench", (0, 0, 0), 0.0, (0.45, 1.6, 0.85)))
    there = _thing(make_layout, Placement("bench", (100, -50, 0.15), np.pi / 2, (0.45, 1.6, 0.85)))
    x, y, z = _used(here).T
    np.testing.assert_allclose(_used(there), np.column_stack([100 - y, -50 + x, z + 0.15]), atol=2e-5)


def test_trees_of_one_kind_share_their_shape_but_not_their_color(make_layout: Make) -> None:
    both = scenery(make_layout([], [Placement("tree", (10.0 * i, 0, 0), 0.0, (4, 4, 8), 2) for i in (0, 1)]), 1)
    first, second = np.split(both.triangles[NUM_GROUND:], 2)
    np.testing.assert_allclose(both.vertices_m[first] + [10, 0, 0], both.vertices_m[second], atol=1e-5)
    assert not np.array_equal(*np.split(both.color[NUM_GROUND:], 2))


def test_windows_doors_and_roofs_are_there(make_layout: Make) -> None:
    street = [Placement("building", (0, 20.0 * i, 0), 0.0, (12, 18, 15), i) for i in range(12)]
    mesh = scenery(make_layout([], street), 1)
    assert {INDEX[name] for name in ("window", "lit_window", "roof", "wood")} <= set(mesh.material.tolist())
    lit = (mesh.material == INDEX["lit_window"]).sum()
    assert 0.05 < lit / (lit + (mesh.material == INDEX["window"]).sum()) < 0.5


@pytest.mark.parametrize(("world", "most"), [("urban", 400_000), ("highway", 300_000)])
def test_worlds_are_bounded_sound_and_the_same_every_time(
    world: Literal["urban", "highway"], most: int, areas: Callable[[Mesh], Array]
) -> None:
    plan = layout(world, 3)
    one, same, other = scenery(plan, 3), scenery(plan, 3), scenery(plan, 4)
    fields = ("vertices_m", "triangles", "material", "color", "lamp")
    assert all(getattr(one, name).tobytes() == getattr(same, name).tobytes() for name in fields)
    assert one.vertices_m.tobytes() != other.vertices_m.tobytes()
    assert 50_000 < len(one) <= most
    assert areas(one).min() > 1e-7
    assert np.isfinite(one.vertices_m).all()
    groups = {p.signal for p in plan.placements if p.signal is not None}
    shown = {group for group in groups if np.isin([3 * group, 3 * group + 2], one.lamp).all()}
    assert shown == groups
    assert one.lamp.max() < max(3 * plan.map.signals.num_groups, 1)


def test_a_thing_looks_the_same_whatever_stands_elsewhere(make_layout: Make) -> None:
    post = Placement("sign", (5, 5, 0), 1.0, (0.1, 0.6, 2.6), 2)
    bench = Placement("bench", (9, 5, 0), 1.0, (0.45, 1.6, 0.85))
    alone = _thing(make_layout, post)
    beside = scenery(make_layout([], [bench, post, replace(bench, position_m=(20, 5, 0))]), 1)
    assert np.array_equal(beside.vertices_m[beside.triangles[-len(alone) :]], alone.vertices_m[alone.triangles])
