"""The city's ray caster against bare Embree on one merged mesh of the same instant, in one process."""

import time
from collections.abc import Callable

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from fbench.datasets.city.actor import Actor, Body
from fbench.datasets.city.mesh import Mesh, merged, moved
from fbench.datasets.city.motion import BodyStates
from fbench.datasets.city.rays.caster import EmbreeCaster
from fbench.datasets.city.rays.hits import Rays
from fbench.datasets.city.rig import RadarSpec, thesis_rig
from fbench.datasets.city.sensors.lidar import sweep
from fbench.datasets.city.sensors.lidar_firing import firing
from fbench.datasets.city.shapes import Skin, box, cylinder, quad
from fbench.replay.weather import Weather

GREY = (0.5, 0.5, 0.5)
RIG = thesis_rig()


def street(rng: np.random.Generator) -> Mesh:
    """120,000 triangles of houses along a street of 400 m."""
    ground = quad(np.array([(-500, -500, 0), (500, -500, 0), (500, 500, 0), (-500, 500, 0.0)]), Skin("asphalt", GREY))
    side = rng.choice([-1, 1], 10_000) * rng.uniform(12, 200, 10_000)
    middles = np.column_stack([rng.uniform(-200, 200, 10_000), side, np.full(10_000, 3.0)])
    sizes = rng.uniform(0.5, 6, (10_000, 3))
    return merged(
        [ground, *(box(tuple(m), tuple(s), Skin("brick", GREY)) for m, s in zip(middles, sizes, strict=True))]
    )


def car() -> Body:
    trunk = box((0, 0, 0.8), (4.5, 1.8, 1.0), Skin("paint", GREY))
    wheels = [cylinder((x, -0.9, 0.3), (x, 0.9, 0.3), 0.3, 24, Skin("rubber", GREY)) for x in (-1.4, 1.4)]
    return Body("car", (4.5, 1.8, 1.5), (merged([trunk, *wheels]),))


def traffic(num: int, rng: np.random.Generator) -> BodyStates:
    x = np.concatenate([[0.0], np.repeat(np.linspace(-150, 150, (num + 3) // 4), 4)[: num - 1] + 2.3])
    lane = np.concatenate([[0.0], np.tile([-8.5, -5, 5, 8.5], (num + 3) // 4)[: num - 1]])
    position = np.column_stack([x, lane, np.zeros(num)])
    flat, none = np.zeros(num), np.zeros(num, bool)
    velocity = np.column_stack([rng.uniform(0, 15, num), flat, flat])
    return BodyStates(0.0, position, rng.uniform(-0.1, 0.1, num), velocity, flat, flat, none, none[:0])


def camera_rays() -> Rays:
    width, height = RIG.cameras["camera"].size_wh
    u, v = np.meshgrid(np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2)
    f = RIG.cameras["camera"].model().K[0, 0]
    d = np.stack([np.ones_like(u), -u / f, -v / f], axis=-1).reshape(-1, 3)
    return Rays(np.array([[2.0, 0, 1]]), unit(d), 300.0)


def radar_rays(spec: RadarSpec, rng: np.random.Generator) -> Rays:
    num = round(spec.points_per_s / spec.rate_hz)
    half = np.radians([spec.horizontal_fov_deg, spec.vertical_fov_deg]) / 2
    angle = rng.uniform(-half, half, (num, 2))
    angle = angle[np.argsort(angle[:, 0], kind="stable")]  # as the city's radar shoots
    return Rays(np.array([[2.0, 0, 1]]), unit(np.column_stack([np.ones(num), np.tan(angle)])), spec.range_m)


def lidar_rays(moving: bool) -> Rays:
    shots = firing(RIG.lidars["lidar"])
    num = len(shots.direction)
    if not moving:
        return Rays(np.array([[0.0, 0, 2]]), shots.direction.astype(np.float32), 100.0)
    offset_s = shots.offset_ns * 1e-9
    origin = np.column_stack([10 * offset_s, np.zeros(num), np.full(num, 2.0)])
    return Rays(origin, shots.direction.astype(np.float32), 100.0, offset_s)


def shadow_rays(caster: EmbreeCaster, states: BodyStates) -> Rays:
    """From all that a camera sees to the sun."""
    seen = camera_rays()
    hits = caster.cast(seen, states)
    on = np.isfinite(hits.range_m)
    point = seen.origin_m + seen.direction[on].astype(np.float64) * hits.range_m[on, None] + 0.01 * hits.normal[on]
    return Rays(point, unit(np.tile([0.3, 0.5, 0.7], (len(point), 1))), 300.0)


def unit(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(vectors / np.sqrt((vectors * vectors).sum(axis=1))[:, None], np.float32)


def best_s(*functions: Callable[[], object], repeat: int = 9) -> list[float]:
    """Shortest time of each, taken in turns; of this thread alone, since other work may share the machine."""
    times: list[list[float]] = [[] for _ in functions]
    for _ in range(repeat):
        for function, taken in zip(functions, times, strict=True):
            start = time.thread_time()
            function()
            taken.append(time.thread_time() - start)
    return [min(taken) for taken in times]


def compare(name: str, caster: EmbreeCaster, states: BodyStates, rays: Rays, bare: EmbreeScene) -> None:
    num = len(rays.direction)
    origin = np.array(np.broadcast_to(rays.origin_m, (num, 3)), np.float32)
    limit = np.full(num, rays.range_m, np.float32)
    if name == "shadows":
        ours_s, bare_s = best_s(
            lambda: caster.blocked(rays, states),
            lambda: bare.run(origin, rays.direction, dists=limit, query="OCCLUDED"),
        )
    else:
        ours_s, bare_s = best_s(
            lambda: caster.cast(rays, states),
            lambda: bare.run(origin, rays.direction, dists=limit.copy(), output=True),
        )
    print(f"{name}, {num} rays: {num / ours_s / 1e6:.1f} M rays/s, Embree {num / bare_s / 1e6:.1f} M rays/s, "
          f"{bare_s / ours_s:.2f} of it")  # fmt: skip


def among(num: int, static: Mesh, rng: np.random.Generator) -> None:
    """Compare all kinds of rays among so many bodies."""
    body, states = car(), traffic(num, rng)
    caster = EmbreeCaster(static, (Actor(body),) * num)
    whole = merged([static, *(moved(body.phases[0], states.world_T_body(i)) for i in range(1, num))])
    bare = EmbreeScene()
    TriangleMesh(bare, np.array(whole.vertices_m), np.array(whole.triangles))
    print(f"{len(static)} triangles that stand, {num} bodies of {len(body.phases[0])}")
    compare("camera", caster, states, camera_rays(), bare)
    compare("radar", caster, states, radar_rays(RIG.radars["radar"], rng), bare)
    compare("LiDAR", caster, states, lidar_rays(False), bare)
    compare("LiDAR in motion", caster, states, lidar_rays(True), bare)
    compare("shadows", caster, states, shadow_rays(caster, states), bare)
    spec, mount = RIG.lidars["lidar"], RIG.rig().body_T_sensor("lidar")
    (turn_s,) = best_s(lambda: sweep(caster, states, spec, "lidar", mount, Weather(), 0, 50_000_000, 60_000_000))
    print(f"a turn of the LiDAR: {1e3 * turn_s:.1f} ms")


def main() -> None:
    rng = np.random.Generator(np.random.Philox(7))
    static = street(rng)
    for num in (50, 250):
        among(num, static, rng)


if __name__ == "__main__":
    main()
