from functools import cache

import numpy as np
import pytest
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from fbench.datasets.city.bodies.cars import make_car
from fbench.datasets.city.bodies.lorries import KINDS as LORRIES
from fbench.datasets.city.bodies.lorries import make_truck
from fbench.datasets.city.bodies.make import KINDS, make_body
from fbench.datasets.city.instant import BRAKE, HEAD, TAIL
from fbench.datasets.city.mesh import INDEX, Body, Mesh
from fbench.replay.conditions.generators import generator
from fbench.replay.contracts.errors import ConfigError

SIZES_M = {
    "car": ((3.5, 5.0), (1.7, 2.2), (1.4, 1.85)), "van": ((4.8, 6.1), (1.9, 2.5), (1.85, 2.7)),
    "truck": ((6.0, 16.1), (2.4, 2.9), (2.6, 4.0)), "bus": ((10.4, 12.1), (2.5, 2.9), (2.9, 3.5)),
    "motorcycle": ((1.9, 2.4), (0.7, 1.0), (1.5, 1.9)), "bicycle": ((1.6, 1.9), (0.5, 0.85), (1.5, 2.0)),
    "pedestrian": ((0.45, 1.2), (0.3, 0.85), (1.05, 2.05)),
}  # fmt: skip
"""Length, width with mirrors, height."""
BUDGET = {"car": 1500, "van": 1500, "truck": 2000, "bus": 2000, "motorcycle": 1700, "bicycle": 1500, "pedestrian": 720}
VEHICLES = ("car", "van", "truck", "bus", "motorcycle", "bicycle")
NUM_DRAWS = 6


@cache
def bodies(kind: str) -> list[Body]:
    """Some of a kind; made for the first test that looks at them, as that takes seconds."""
    made = [make_body(kind, generator(1, kind, i)) for i in range(NUM_DRAWS)]
    if kind == "car":
        made += [make_car(generator(2, style), style) for style in ("hatchback", "sedan", "estate", "suv")]
    if kind == "truck":
        made += [make_truck(generator(2, lorry), lorry) for lorry in LORRIES]
    return made


def corners(mesh: Mesh) -> np.ndarray:
    return mesh.vertices_m.astype(np.float64)[mesh.triangles]


def normals(mesh: Mesh) -> np.ndarray:
    a, b, c = corners(mesh).transpose(1, 0, 2)
    return np.cross(b - a, c - a)


def middles(mesh: Mesh, chosen: np.ndarray) -> np.ndarray:
    return corners(mesh)[chosen].mean(1)


@pytest.mark.parametrize("kind", KINDS)
def test_the_box_is_exact_and_plausible(kind: str) -> None:
    for body in bodies(kind):
        points = np.concatenate([mesh.vertices_m for mesh in body.phases]).astype(np.float64)
        assert np.isfinite(points).all()
        low, high, size = points.min(0), points.max(0), np.array(body.size_lwh_m)
        np.testing.assert_allclose(high - low, size, atol=1e-4)
        np.testing.assert_allclose((high + low)[:2], 0, atol=1e-4)
        assert (np.abs(points[:, :2]) <= size[:2] / 2).all()
        assert (points[:, 2] <= size[2]).all()
        assert all(abs(float(mesh.vertices_m[:, 2].min())) < 1e-3 for mesh in body.phases)
        assert all(a <= v <= b for v, (a, b) in zip(size, SIZES_M[kind], strict=True))


@pytest.mark.parametrize("kind", KINDS)
def test_label_phases_and_budget(kind: str) -> None:
    for body in bodies(kind):
        assert body.label == kind
        assert len(body.phases) == {"pedestrian": 12, "bicycle": 8}.get(kind, 1)
        assert max(map(len, body.phases)) <= BUDGET[kind]


@pytest.mark.parametrize("kind", KINDS)
def test_no_triangle_is_degenerate_and_colors_are_albedos(kind: str) -> None:
    for body in bodies(kind):
        for mesh in body.phases:
            assert np.linalg.norm(normals(mesh), axis=1).min() / 2 > 5e-8
            assert mesh.color.min() >= 0
            assert mesh.color.max() <= 1


@pytest.mark.parametrize("kind", KINDS)
def test_surfaces_look_outward(kind: str) -> None:
    for body in bodies(kind):
        mesh = body.phases[0]
        scene = EmbreeScene(robust=True)
        TriangleMesh(scene, mesh.vertices_m, mesh.triangles)
        draw, size = generator(3, kind), np.array(body.size_lwh_m)
        away = draw.normal(size=(20000, 3))
        away[:, 2] = np.abs(away[:, 2])
        origin = 20 * away / np.linalg.norm(away, axis=1, keepdims=True)
        target = draw.uniform(-0.5, 0.5, (20000, 3)) * size + (0, 0, size[2] / 2)
        ray = (target - origin) / np.linalg.norm(target - origin, axis=1, keepdims=True)
        hit = scene.run(origin.astype(np.float32), ray.astype(np.float32))
        met = hit >= 0
        assert met.sum() > 1000
        towards = (normals(mesh)[hit[met]] * ray[met]).sum(1) < 0
        assert towards.mean() > 0.97
        a, b, c = corners(mesh).transpose(1, 0, 2)
        assert (a * np.cross(b, c)).sum() / 6 > 0.02


@pytest.mark.parametrize("kind", VEHICLES)
def test_lamps_and_glass(kind: str) -> None:
    for body in bodies(kind):
        mesh = body.phases[0]
        heads, tails, brakes = (middles(mesh, mesh.lamp == lamp) for lamp in (HEAD, TAIL, BRAKE))
        assert min(len(heads), len(tails), len(brakes)) > 0
        quarter = body.size_lwh_m[0] / 5
        assert heads[:, 0].min() > quarter
        assert max(tails[:, 0].max(), brakes[:, 0].max()) < -quarter
        assert set(mesh.material[mesh.lamp == HEAD].tolist()) == {INDEX["headlight"]}
        assert set(mesh.material[(mesh.lamp == TAIL) | (mesh.lamp == BRAKE)].tolist()) == {INDEX["taillight"]}
        if kind not in ("motorcycle", "bicycle"):
            assert (mesh.material == INDEX["glass"]).sum() > 4
            assert len(np.unique(np.sign(heads[:, 1]))) == 2
        if kind != "bicycle":
            assert (middles(mesh, mesh.material == INDEX["plate"])[:, 0] < -quarter).any()


@pytest.mark.parametrize("kind", VEHICLES)
def test_wheels_stand_on_the_ground(kind: str) -> None:
    for body in bodies(kind):
        mesh = body.phases[0]
        rubber = mesh.triangles[mesh.material == INDEX["rubber"]]
        points = mesh.vertices_m[np.unique(rubber)]
        feet = points[points[:, 2] < 0.005]
        places = {(round(float(x) / 0.15), int(np.sign(round(float(y), 1)))) for x, y, _ in feet}
        if kind in ("motorcycle", "bicycle"):
            assert len({x for x, _ in places}) >= 2
        else:
            assert {side for _, side in places} == {-1, 1}
            assert len({x for x, _ in places}) >= 2


@pytest.mark.parametrize("kind", ["car", "van", "truck", "bus"])
def test_rays_pass_under_vehicles(kind: str) -> None:
    body = bodies(kind)[0]
    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, body.phases[0].vertices_m, body.phases[0].triangles)
    origin = np.array([[0, 5, 0.1], [0, 5, 0.6 * body.size_lwh_m[2]]], np.float32)
    hit = scene.run(origin, np.tile(np.array([[0, -1, 0]], np.float32), (2, 1)))
    assert hit[0] < 0
    assert hit[1] >= 0 or kind == "truck"


@pytest.mark.parametrize("kind", KINDS)
def test_same_draw_same_bytes_other_draw_other_body(kind: str) -> None:
    again = make_body(kind, generator(1, kind, 0))
    assert content(again) == content(bodies(kind)[0])
    assert len({body.size_lwh_m for body in bodies(kind)}) == len(bodies(kind))
    assert len({body.phases[0].color.tobytes() for body in bodies(kind)}) > NUM_DRAWS // 2


def content(body: Body) -> bytes:
    parts = [part.tobytes() for m in body.phases for part in (m.vertices_m, m.triangles, m.material, m.color, m.lamp)]
    return repr((body.label, body.size_lwh_m)).encode() + b"".join(parts)


def test_the_gait_is_symmetric_by_half_a_cycle() -> None:
    for body in bodies("pedestrian")[:3]:
        for i in range(6):
            ours, other = (feet_of(body.phases[k]) for k in (i, i + 6))
            np.testing.assert_allclose(ours[0], other[1], atol=0.03)
            np.testing.assert_allclose(ours[1], other[0], atol=0.03)


def test_the_gait_goes_on_smoothly_and_swings() -> None:
    body = bodies("pedestrian")[0]
    feet = np.array([feet_of(mesh) for mesh in body.phases])
    steps = np.linalg.norm(feet - np.roll(feet, 1, axis=0), axis=2)
    assert steps.max() < 0.4
    assert np.ptp(feet[:, 0, 0]) > 0.35
    assert np.all(np.abs(feet[0, :, 0]) < 0.25)
    assert feet[:, :, 1].min() < 0.12
    assert feet[:, :, 1].max() < 0.45


def feet_of(mesh: Mesh) -> np.ndarray:
    """Mean x and z of the left and the right shoe's lowest parts: vertices of the last parts are found by height."""
    points = mesh.vertices_m
    shoe = points[np.unique(mesh.triangles[shoe_triangles(mesh)])]
    return np.array([[shoe[side][:, 0].mean(), shoe[side][:, 2].mean()] for side in (shoe[:, 1] > 0, shoe[:, 1] < 0)])


def shoe_triangles(mesh: Mesh) -> np.ndarray:
    """Those that share the look of the lowest triangle and lie in the lower third."""
    height = corners(mesh).mean(1)[:, 2]
    first = int(np.argmin(height))
    alike = (mesh.color == mesh.color[first]).all(1) & (mesh.material == mesh.material[first])
    return alike & (height < 0.33 * mesh.vertices_m[:, 2].max())


def test_pedals_turn_and_wheels_do_not() -> None:
    body = bodies("bicycle")[0]
    first, half = body.phases[0].vertices_m, body.phases[4].vertices_m
    moved = np.abs(first - half).max(1) > 0.05
    assert 0.05 < moved.mean() < 0.7


def test_unknown_kind() -> None:
    with pytest.raises(ConfigError, match=r"no road user 'tram': choose one of car, van, truck, bus"):
        make_body("tram", generator(1))
