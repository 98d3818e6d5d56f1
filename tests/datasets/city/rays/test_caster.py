"""What rays hit: against planes and boxes worked out by hand, and an oracle of slabs."""

from threading import Thread

import numpy as np
import pytest

from fbench.datasets.city.instant import MISS, STATIC, Rays
from fbench.datasets.city.mesh import INDEX, Actor, Body, Skin, box, merge_meshes, quad
from fbench.datasets.city.rays.caster import EmbreeCaster

ASPHALT, BRICK = Skin("asphalt", (0.2, 0.2, 0.2)), Skin("brick", (0.5, 0.2, 0.2))
GROUND = quad(np.array([(-1500.0, -1500, 0), (1500, -1500, 0), (1500, 1500, 0), (-1500, 1500, 0)]), ASPHALT)
WALL = quad(np.array([(50.0, 30, 0), (50, -30, 0), (50, -30, 20), (50, 30, 20)]), BRICK)


def rays(origin, direction, range_m=200.0, offset_s=None):
    d = np.atleast_2d(np.asarray(direction, np.float64))
    d = d / np.sqrt((d * d).sum(axis=1))[:, None]
    offset = None if offset_s is None else np.asarray(offset_s, np.float64)
    return Rays(np.atleast_2d(np.asarray(origin, np.float64)), d.astype(np.float32), range_m, offset)


def around(num, seed=0):
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(num, 3)) * [1, 1, 0.15]
    return d / np.sqrt((d * d).sum(axis=1))[:, None]


def slab_range(origin, direction, position, yaw, size=(4.0, 2.0, 1.5)):
    """Distance to the outside of one upright box, by the slab method in double precision; infinite for misses."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    o, d = origin - position, direction.astype(np.float64)
    o = np.stack([cos * o[:, 0] + sin * o[:, 1], cos * o[:, 1] - sin * o[:, 0], o[:, 2]], axis=1)
    d = np.stack([cos * d[:, 0] + sin * d[:, 1], cos * d[:, 1] - sin * d[:, 0], d[:, 2]], axis=1)
    low, high = np.array([-size[0] / 2, -size[1] / 2, 0]), np.array([size[0] / 2, size[1] / 2, size[2]])
    with np.errstate(divide="ignore"):
        a, b = (low - o) / d, (high - o) / d
    enters, leaves = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
    return np.where((enters <= leaves) & (enters > 0), enters, np.inf)


def test_static_hits_by_hand(crates, states):
    caster = EmbreeCaster(merge_meshes([GROUND, WALL]), crates(1))
    hits = caster.cast(rays((0, 0, 2), [(1, 0, 0), (0, 0, -1), (1, 0, -1), (-1, 0, 1)]), states([(0, 0)]))
    np.testing.assert_allclose(hits.range_m, [50, 2, 2 * np.sqrt(2), np.inf], rtol=1e-6)
    assert hits.body.tolist() == [STATIC, STATIC, STATIC, MISS]
    assert hits.triangle[3] == -1
    assert set(hits.triangle[1:3]) <= {0, 1}
    assert hits.triangle[0] in {2, 3}
    np.testing.assert_allclose(hits.normal, [(-1, 0, 0), (0, 0, 1), (0, 0, 1), (0, 0, 0)], atol=1e-6)
    assert caster.material(hits, states([(0, 0)])).tolist() == [
        INDEX["brick"], INDEX["asphalt"], INDEX["asphalt"], 255,
    ]  # fmt: skip


def test_normals_face_the_ray_from_both_sides(crates, states):
    caster = EmbreeCaster(WALL, crates(1))
    hits = caster.cast(rays([(0, 0, 2), (100, 0, 2)], [(1, 0, 0), (-1, 0, 0)]), states([(0, 0)]))
    np.testing.assert_allclose(hits.normal, [(-1, 0, 0), (1, 0, 0)], atol=1e-6)


def test_a_turned_body_by_hand(crates, states, nothing):
    now = states([(0, 0), (20, 0, np.pi / 2)])
    caster = EmbreeCaster(nothing, crates(2))
    hits = caster.cast(rays((0, 0, 1), (1, 0, 0)), now)
    np.testing.assert_allclose(hits.range_m, [19], rtol=1e-6)  # half its width of 2 m, since it stands across
    np.testing.assert_allclose(hits.normal, [(-1, 0, 0)], atol=1e-6)
    assert hits.body.tolist() == [1]
    assert caster.material(hits, now).tolist() == [INDEX["paint"]]


def test_the_ego_vehicle_is_never_hit(crates, states, nothing):
    caster = EmbreeCaster(nothing, crates(1))
    at = states([(10, 0)])
    assert caster.cast(rays((0, 0, 1), (1, 0, 0)), at).body.tolist() == [MISS]
    assert caster.cast(rays((10, 0, 1), around(100)), at).alone == ()
    assert not caster.is_blocked(rays((0, 0, 1), (1, 0, 0)), at).any()


@pytest.mark.parametrize("common", [True, False])
def test_bodies_agree_with_slabs(crates, states, nothing, common):
    rng = np.random.default_rng(3)
    rows = np.column_stack([rng.uniform(-80, 80, (40, 2)), rng.uniform(-4, 4, 40)])
    rows = rows[(np.abs(rows[:, :2]) > 6).any(axis=1)]
    now, d = states([(0, 0), *rows]), around(20_000)
    beams = rays((0, 0, 1) if common else np.tile([0, 0, 1.0], (len(d), 1)) + rng.uniform(-1, 1, (len(d), 3)), d)
    origin = np.broadcast_to(beams.origin_m, d.shape)
    expected = np.stack([slab_range(origin, beams.direction, (x, y, 0), yaw) for x, y, yaw in rows], axis=1)
    hits = EmbreeCaster(nothing, crates(len(rows) + 1)).cast(beams, now)
    nearest, second = np.sort(expected, axis=1)[:, :2].T
    sure = np.isfinite(nearest) == np.isfinite(hits.range_m)
    assert (~sure).sum() <= 3  # rays along an edge
    finite = sure & np.isfinite(nearest)
    np.testing.assert_allclose(hits.range_m[finite], nearest[finite], atol=1e-4)
    clear = finite & (second > nearest + 1e-3)
    np.testing.assert_array_equal(hits.body[clear], 1 + expected.argmin(axis=1)[clear])
    for i, alone in hits.alone:
        assert len(np.setxor1d(alone, np.flatnonzero(np.isfinite(expected[:, i - 1])))) <= 2
    seen = {i for i, _ in hits.alone}
    assert {i + 1 for i in np.flatnonzero(np.isfinite(expected).sum(axis=0) > 2)} <= seen


def test_bodies_move_until_their_ray_is_shot(crates, states, nothing):
    offset = np.linspace(-0.5, 0.5, 4001)
    now = states([(0, 0), (20, -3, 0.4, 6, 10, 1.5)])
    d = np.column_stack([np.ones(4001), (np.arange(4001) % 21 - 10) / 15, np.zeros(4001)])
    beams = rays((0, 0, 1), d, offset_s=offset)
    hits = EmbreeCaster(nothing, crates(2)).cast(beams, now)
    for k in range(0, 4001, 7):
        position, yaw = np.array([20 + 6 * offset[k], -3 + 10 * offset[k], 0]), 0.4 + 1.5 * offset[k]
        want = slab_range(np.array([(0, 0, 1.0)]), beams.direction[k : k + 1], position, yaw)[0]
        assert hits.range_m[k] == pytest.approx(want, abs=1e-4)
    np.testing.assert_array_equal(hits.alone[0][1], np.flatnonzero(hits.body == 1))
    hit = np.flatnonzero(hits.body == 1)
    assert 200 < len(hit) < 3800
    yaw = 0.4 + 1.5 * offset[hit]
    local_x = np.cos(yaw) * hits.normal[hit, 0] + np.sin(yaw) * hits.normal[hit, 1]
    local_y = np.cos(yaw) * hits.normal[hit, 1] - np.sin(yaw) * hits.normal[hit, 0]
    np.testing.assert_allclose(np.maximum(np.abs(local_x), np.abs(local_y)), 1, atol=1e-5)  # along one of its axes


def test_alone_counts_what_is_hidden(crates, states):
    beams = rays((0, 0, 1), np.column_stack([np.ones(400), np.linspace(-0.2, 0.2, 400), np.zeros(400)]))
    wall = box((10, -2, 1), (0.2, 4, 2), BRICK)
    now = states([(0, 0), (30, 0, np.pi / 2)])
    hits = EmbreeCaster(wall, crates(2)).cast(beams, now)
    assert [i for i, _ in hits.alone] == [1]
    rows = hits.alone[0][1]
    angle = np.linspace(-0.2, 0.2, 400)
    np.testing.assert_array_equal(rows, np.flatnonzero(np.abs(angle) <= 2 / 29))
    np.testing.assert_array_equal(hits.body[rows] == 1, angle[rows] > 0)


def test_ranges_end(crates, states):
    caster = EmbreeCaster(WALL, crates(2))
    now = states([(0, 0), (30, 0)])
    short = caster.cast(rays((0, 0, 1), (1, 0, 0), 27.9), now)
    assert short.body.tolist() == [MISS]
    assert short.alone == ()
    assert np.isinf(short.range_m).all()
    long = caster.cast(rays((0, 0, 1), (1, 0, 0), 28.1), now)
    assert long.body.tolist() == [1]
    blocked = [bool(caster.is_blocked(rays((0, 0, 1), (1, 0, 0), r), now)[0]) for r in (27.9, 28.1)]
    assert blocked == [False, True]
    assert not caster.is_blocked(rays((0, 0, 3), (1, 0, 0), 49.9), now)[0]
    assert caster.is_blocked(rays((0, 0, 3), (1, 0, 0), 50.1), now)[0]


def test_blocked_is_what_cast_hits(crates, states):
    rng = np.random.default_rng(5)
    now = states([(0, 0), *np.column_stack([rng.uniform(-60, 60, (30, 2)), rng.uniform(-3, 3, 30)])])
    caster = EmbreeCaster(merge_meshes([GROUND, WALL]), crates(31))
    origin = np.column_stack([rng.uniform(-60, 60, (5000, 2)), np.full(5000, 0.01)])
    for direction in (np.tile([0.5, 0.3, 0.2], (5000, 1)), around(5000)):
        for offset in (None, rng.uniform(-0.1, 0.1, 5000)):
            beams = rays(origin, direction, 80.0, offset)
            hits = caster.cast(beams, now)
            np.testing.assert_array_equal(caster.is_blocked(beams, now), hits.body != MISS)


def test_phases_choose_the_mesh(crate, states, nothing):
    low = box((0, 0, 0.25), (4, 2, 0.5), Skin("cloth", (0.1, 0.1, 0.1)))
    walker = Actor(Body("pedestrian", (4.0, 2.0, 1.5), (crate.phases[0], low)))
    caster = EmbreeCaster(nothing, (Actor(crate), walker))
    for phase, body in ((0.0, 1), (0.49, 1), (0.5, MISS), (0.99, MISS)):
        now = states([(0, 0), (10, 0)], [0.0, phase])
        assert caster.cast(rays((0, 0, 1), (1, 0, 0)), now).body.tolist() == [body]
    now = states([(0, 0), (10, 0)], [0.0, 0.7])
    hits = caster.cast(rays((0, 0, 0.4), (1, 0, 0)), now)
    assert caster.material(hits, now).tolist() == [INDEX["cloth"]]


def test_without_rays_bodies_or_world(crates, states, nothing):
    no_rays = Rays(np.zeros((1, 3)), np.zeros((0, 3), np.float32), 100.0)
    for static, num in ((nothing, 1), (nothing, 3), (GROUND, 1), (GROUND, 3)):
        caster, now = EmbreeCaster(static, crates(num)), states([(10.0 * i, 0) for i in range(num)])
        hits = caster.cast(no_rays, now)
        assert len(hits.range_m) == len(hits.body) == len(hits.normal) == len(caster.is_blocked(no_rays, now)) == 0
        assert hits.alone == ()
        assert len(caster.material(hits, now)) == 0
    empty = EmbreeCaster(nothing, (*crates(1), Actor(Body("other", (1.0, 1.0, 1.0), (nothing,)))))
    hits = empty.cast(rays((0, 0, 1), around(10)), states([(0, 0), (3, 0)]))
    assert (hits.body == MISS).all()
    assert (empty.material(hits, states([(0, 0), (3, 0)])) == 255).all()
    assert (hits.normal == 0).all()


def test_points_lie_on_surfaces_far_from_the_origin(crates, states):
    """To 2 mm along the surface's normal at 100 m, 1 km from the world's origin, for grazing rays too."""
    center = np.array([900.37, -431.21, 2.0])
    tower = box((float(center[0]) + 60, float(center[1]) + 7, 10), (8, 30, 20), BRICK)
    rows = [(0, 0), *((center[0] + 90 * np.cos(a), center[1] + 90 * np.sin(a), a) for a in np.arange(1, 7))]
    caster = EmbreeCaster(merge_meshes([GROUND, tower]), crates(7))
    beams = rays(center, around(50_000), 100.0)
    hits = caster.cast(beams, states(rows))
    point = center + beams.direction.astype(np.float64) * hits.range_m[:, None]
    off_ground = np.abs(point[(hits.normal[:, 2] > 0.5) & (hits.body == STATIC), 2])
    assert np.minimum(off_ground, np.abs(off_ground - 20)).max() < 2e-3
    side = (np.abs(hits.normal[:, 0]) > 0.5) & (hits.body == STATIC)
    np.testing.assert_allclose(np.abs(point[side, 0] - center[0] - 60), 4, atol=2e-3)
    for i in range(1, 7):
        x, y, yaw = rows[i]
        on = hits.body == i
        assert on.sum() > 5
        d = point[on] - (x, y, 0)
        local = np.stack([np.cos(yaw) * d[:, 0] + np.sin(yaw) * d[:, 1], np.cos(yaw) * d[:, 1] - np.sin(yaw) * d[:, 0]])
        outside = np.maximum(np.abs(local[0]) - 2, np.maximum(np.abs(local[1]) - 1, np.abs(d[:, 2] - 0.75) - 0.75))
        assert np.abs(outside).max() < 2e-3


def test_no_ray_slips_through_between_triangles(crates, states):
    corners = np.arange(-40.0, 41)
    patches = [
        quad(np.array([(x, y, 0), (x + 1, y, 0), (x + 1, y + 1, 0), (x, y + 1, 0)]), ASPHALT)
        for x in corners[:-1] for y in corners[:-1]
    ]  # fmt: skip
    caster = EmbreeCaster(merge_meshes(patches), crates(1))
    target = np.stack(np.meshgrid(np.arange(-39, 39.5, 0.5), np.arange(-39, 39.5, 0.5), [0.0]), -1).reshape(-1, 3)
    hits = caster.cast(rays((0.3, 0.2, 3), target - (0.3, 0.2, 3)), states([(0, 0)]))
    assert (hits.body == STATIC).all()


def test_threads_get_the_same_bytes(crates, states):
    rng = np.random.default_rng(9)
    rows = [(0, 0), *np.column_stack([rng.uniform(-60, 60, (60, 2)), rng.uniform(-3, 3, 60)])]
    caster, now = EmbreeCaster(merge_meshes([GROUND, WALL]), crates(61)), states(rows)
    beams = rays((0, 0, 2), around(20_000))
    found = []

    def work():
        hits = caster.cast(beams, now)
        rows = b"".join(alone.tobytes() for _, alone in hits.alone)
        found.append(
            (hits.range_m.tobytes(), hits.body.tobytes(), hits.triangle.tobytes(), hits.normal.tobytes(), rows)
        )

    threads = [Thread(target=work) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 6
    assert len(set(found)) == 1


def test_origins_may_be_part_of_a_matrix(crates, states):
    """Kernels want arrays without gaps."""
    pose = np.eye(4)
    pose[:3, 3] = 0, 0, 1
    beams = Rays(pose[None, :3, 3], np.eye(3, dtype=np.float32)[:, :1].T, 100.0)
    assert beams.origin_m.flags.c_contiguous
    assert EmbreeCaster(WALL, crates(2)).cast(beams, states([(0, 0), (30, 0)])).range_m.tolist() == [28.0]
