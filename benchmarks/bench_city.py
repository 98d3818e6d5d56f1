"""The city's sensors against bare Embree, which follows the same rays through one mesh; and whole logs."""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from common import best_s
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from fbench.datasets.city.instant import EGO, BodyStates, Hits, Rays
from fbench.datasets.city.measure import Slot, Surroundings, measure
from fbench.datasets.city.mesh import merge_meshes, move_mesh
from fbench.datasets.city.rays.caster import EmbreeCaster
from fbench.datasets.city.recording import CityRecording, build_city
from fbench.datasets.city.request import SEEDS
from fbench.datasets.city.rig import RigSpec, thesis_rig
from fbench.datasets.city.spec import CitySpec
from fbench.datasets.city.world.urban import layout
from fbench.replay.conditions.weather import Weather
from fbench.replay.data.arrays import Bool

RIG = thesis_rig()
SEED, AT_S, REPEAT = SEEDS["dev"][0], 1.0, 5
LOG_SECONDS = 4.0


class Watched(EmbreeCaster):
    """A caster that keeps the rays that pass through it."""

    def __init__(self, caster: EmbreeCaster) -> None:
        self.__dict__.update(caster.__dict__)
        self.nearest, self.shadows = list[Rays](), list[Rays]()

    def cast(self, rays: Rays, states: BodyStates) -> Hits:
        self.nearest.append(rays)
        return super().cast(rays, states)

    def is_blocked(self, rays: Rays, states: BodyStates) -> Bool:
        self.shadows.append(rays)
        return super().is_blocked(rays, states)


def one_scene(caster: EmbreeCaster, states: BodyStates) -> EmbreeScene:
    """All that stands and all bodies but the ego vehicle, where they are, in one mesh."""
    bodies = [(i, actor.body) for i, actor in enumerate(caster.actors) if i != EGO]
    meshes = [
        move_mesh(body.phases[body.mesh_at(float(states.phase[i]))], states.world_T_body(i)) for i, body in bodies
    ]
    whole, scene = merge_meshes([caster.static, *meshes]), EmbreeScene()
    TriangleMesh(scene, np.array(whole.vertices_m), np.array(whole.triangles))
    return scene


def follow(scene: EmbreeScene, rays: Rays, query: dict[str, object]) -> Callable[[], object]:
    num = len(rays.direction)
    origin = np.array(np.broadcast_to(rays.origin_m, (num, 3)), np.float32)
    limit = np.full(num, rays.range_m, np.float32)
    return lambda: scene.run(origin, rays.direction, dists=limit.copy(), **query)


def compare(around: Surroundings, states: BodyStates, scene: EmbreeScene, sensor: str, what: str) -> None:
    watched = Watched(around.caster)
    spec, slot = RIG.specs[sensor], Slot(sensor, round(AT_S * 1e9), round(AT_S * 1e9))
    measure(replace(around, caster=watched), states, spec, slot)

    def cpu_s(function: Callable[[], object]) -> float:
        return best_s(function, REPEAT, time.thread_time)

    ours_s = cpu_s(lambda: measure(around, states, spec, slot))
    cast_s = sum(cpu_s(partial(around.caster.cast, rays, states)) for rays in watched.nearest)
    cast_s += sum(cpu_s(partial(around.caster.is_blocked, rays, states)) for rays in watched.shadows)
    bare_s = sum(cpu_s(follow(scene, rays, {"output": True})) for rays in watched.nearest)
    bare_s += sum(cpu_s(follow(scene, rays, {"query": "OCCLUDED"})) for rays in watched.shadows)
    num = sum(len(r.direction) for r in (*watched.nearest, *watched.shadows)) / 1e6
    print(f"{what}: {num:.2f} M rays in {1e3 * ours_s:.0f} ms, {num / ours_s:.1f} M rays/s; casting alone "
          f"{num / cast_s:.1f}, Embree {num / bare_s:.1f} M rays/s: ratios {bare_s / ours_s:.2f} and "
          f"{bare_s / cast_s:.2f}")  # fmt: skip


def sensors() -> None:
    plan = layout("urban", SEED)
    city = build_city(plan, "urban", False, SEED)
    states = city.traffic.motion(0.0, AT_S + 0.1).at(AT_S)
    scene = one_scene(city.caster, states)
    print(f"urban: {len(city.caster.static)} triangles that stand, {len(city.caster.actors)} bodies")
    for what, weather in (("clear", Weather()), ("night", Weather(lux=0.3, sun_elevation_deg=-30.0))):
        around = Surroundings(city.caster, plan.map.street_lamps_m, weather, SEED, RIG.rig())
        for sensor in (*RIG.cameras, *RIG.lidars, *RIG.radars):
            if what == "clear" or sensor in RIG.cameras:
                compare(around, states, scene, sensor, f"{sensor}, {what}")


def logs() -> None:
    for what, rig in (("with cameras", RIG), ("without", RigSpec(lidars=RIG.lidars, radars=RIG.radars))):
        start = time.perf_counter()
        num = sum(1 for _ in CityRecording(CitySpec("urban", seconds=LOG_SECONDS, seed=SEED, rig=rig), "log").items())
        taken = time.perf_counter() - start
        print(f"urban log of {LOG_SECONDS:g} s, {what}: {num} items, {taken / LOG_SECONDS:.1f} s a second of log, "
              "building the city included")  # fmt: skip


if __name__ == "__main__":
    sensors()
    logs()
