"""Random scenes in plain numbers: read by the oracle in nuscenes-devkit's environment and by the tests in fbench's."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

ATTRIBUTES = {"car": "vehicle", "truck": "vehicle", "bus": "vehicle", "trailer": "vehicle",
              "construction_vehicle": "vehicle", "motorcycle": "cycle", "bicycle": "cycle",
              "pedestrian": "pedestrian"}  # fmt: skip
STATES = {"vehicle": ("vehicle.moving", "vehicle.parked", "vehicle.stopped"),
          "cycle": ("cycle.with_rider", "cycle.without_rider"),
          "pedestrian": ("pedestrian.moving", "pedestrian.standing", "pedestrian.sitting_lying_down")}  # fmt: skip
RACK = "static_object.bicycle_rack"
Row = dict[str, Any]


@dataclass
class Scene:
    """Samples of one scene, and boxes as rows: step, name, id, xyz, lwh, yaw, velocity, attribute, points, score."""

    name: str
    stamp_us: list[int]
    ego: list[tuple[float, float, float]]
    truth: list[Row] = field(default_factory=list)
    results: list[Row] = field(default_factory=list)


@dataclass(frozen=True)
class Plan:
    """What random scenes are like."""

    seed: int
    classes: tuple[str, ...]
    num_scenes: int = 4
    num_steps: int = 12
    num_tracks: int = 30
    spread_m: float = 30.0
    noise_m: float = 0.6
    missed: float = 0.15
    false_per_step: float = 4.0
    switched: float = 0.05
    absent: tuple[str, ...] = ()
    """Classes without truth, but with results."""
    unseen: tuple[str, ...] = ()
    """Classes without results."""
    lost: tuple[str, ...] = ()
    """Classes whose results are all far off."""
    relabelled: float = 0.0
    """Share of boxes of tracks, on both sides, that are of another class."""
    racks: bool = True
    digits: int = 12
    """To which scores of tracks are rounded: few make many equal."""


def scenes_of(plan: Plan) -> list[Scene]:
    """Return random scenes; the same for the same plan, wherever numpy's Philox is."""
    rng = np.random.Generator(np.random.Philox(plan.seed))
    return [_scene(plan, f"scene-{i:04d}", rng) for i in range(plan.num_scenes)]


def _scene(plan: Plan, name: str, rng: np.random.Generator) -> Scene:
    stamps = np.cumsum(rng.integers(400_000, 600_000, plan.num_steps)) + 1_500_000_000_000_000
    origin = rng.uniform(-200, 200, 2)
    ego = [(float(origin[0] + 2.0 * s), float(origin[1]), 0.0) for s in range(plan.num_steps)]
    scene = Scene(name, [int(t) for t in stamps], ego)
    next_id = 1000
    for track in range(plan.num_tracks):
        next_id = _track(plan, scene, track, next_id, rng)
    for step in range(plan.num_steps):
        for _ in range(rng.poisson(plan.false_per_step)):
            kind = str(rng.choice([c for c in plan.classes if c not in plan.unseen]))
            box = _box(kind, step, next_id, _around(scene, step, plan, rng), 0.0, rng)
            scene.results.append({**box, "score": float(round(rng.uniform(0.01, 0.7), plan.digits))})
            next_id += 1
    if plan.racks:
        scene.truth += [_rack(scene, step, rng) for step in range(plan.num_steps)]
    return _shuffled(scene, rng)


def _track(plan: Plan, scene: Scene, track: int, next_id: int, rng: np.random.Generator) -> int:
    """Add one truth track and what a tracker makes of it; returns the next free id."""
    kind = plan.classes[track % len(plan.classes)]
    start, end = sorted(rng.integers(0, plan.num_steps + 1, 2))
    place, heading, speed = _around(scene, int(start), plan, rng), rng.uniform(-np.pi, np.pi), rng.uniform(0, 8)
    base = _box(kind, 0, track, place, heading, rng)
    quality, own = rng.uniform(0.2, 1.0), next_id
    for step in range(start, end):
        at = place + 0.5 * (step - start) * speed * np.array([np.cos(heading), np.sin(heading), 0])
        velocity = speed * np.array([np.cos(heading), np.sin(heading)])
        truth = {**base, "step": int(step), "xyz": _floats(at), "velocity": _floats(velocity)}
        truth["points"] = int(rng.integers(0, 8))
        if rng.random() < 0.05:
            truth["velocity"], truth["attribute"] = (float("nan"), float("nan")), ""
        if rng.random() < plan.relabelled:
            truth["name"] = str(rng.choice(plan.classes))
        if truth["name"] not in plan.absent and rng.random() > 0.05:
            scene.truth.append(truth)
        if rng.random() < plan.switched:
            own = next_id = next_id + 1
        if kind not in plan.unseen and rng.random() > plan.missed:
            off = at + np.append(rng.normal(0, plan.noise_m, 2), 0.0) + (100.0 if kind in plan.lost else 0.0)
            result = _result({**truth, "name": kind}, own, off, quality, plan, rng)
            result["name"] = str(rng.choice(plan.classes)) if rng.random() < plan.relabelled else kind
            scene.results.append(result)
    return next_id + 1


def _result(truth: Row, own: int, at: np.ndarray, quality: float, plan: Plan, rng: np.random.Generator) -> Row:
    size = np.array(truth["lwh"]) * rng.uniform(0.8, 1.25, 3)
    velocity = np.nan_to_num(np.array(truth["velocity"])) + rng.normal(0, 0.5, 2)
    states = STATES.get(ATTRIBUTES.get(str(truth["name"]), ""), ("",))
    yaw = truth["yaw"] + (np.pi if rng.random() < 0.1 else 0.0) + rng.normal(0, 0.2)
    return {
        **truth, "id": own, "xyz": _floats(at), "lwh": _floats(size), "yaw": float(yaw), "velocity": _floats(velocity),
        "attribute": str(rng.choice(states)), "points": -1,
        "score": float(round(np.clip(quality + rng.normal(0, 0.1), 0.01, 0.999), plan.digits)),
    }  # fmt: skip


def _box(kind: str, step: int, own: int, at: np.ndarray, heading: float, rng: np.random.Generator) -> Row:
    states = STATES.get(ATTRIBUTES.get(kind, ""), ("",))
    return {
        "step": step, "name": kind, "id": own, "xyz": _floats(at), "lwh": _floats(rng.uniform(0.5, 5.0, 3)),
        "yaw": float(heading), "velocity": _floats(rng.normal(0, 1, 2)), "attribute": str(rng.choice(states)),
        "points": -1, "score": -1.0,
    }  # fmt: skip


def _rack(scene: Scene, step: int, rng: np.random.Generator) -> Row:
    at = np.array(scene.ego[step]) + np.append(rng.uniform(-15, 15, 2), 0.5)
    return {**_box(RACK, step, 900_000, at, rng.uniform(-3, 3), rng), "lwh": (18.0, 12.0, 4.0), "points": 0}


def _around(scene: Scene, step: int, plan: Plan, rng: np.random.Generator) -> np.ndarray:
    ego = np.array(scene.ego[min(step, plan.num_steps - 1)])
    return np.asarray(ego + np.append(rng.normal(0, plan.spread_m, 2), rng.uniform(0, 1)))


def _shuffled(scene: Scene, rng: np.random.Generator) -> Scene:
    for rows in (scene.truth, scene.results):
        rows[:] = [rows[i] for i in rng.permutation(len(rows))]
        rows.sort(key=lambda row: row["step"])
    return scene


def _floats(values: np.ndarray) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


DETECTION = ("car", "truck", "bus", "trailer", "construction_vehicle", "pedestrian", "motorcycle", "bicycle",
             "traffic_cone", "barrier")  # fmt: skip
TRACKING = ("bicycle", "bus", "car", "motorcycle", "pedestrian", "trailer", "truck")
DETECTION_PLANS = {
    "plain": Plan(1, DETECTION, num_tracks=60),
    "crowded": Plan(2, DETECTION, num_tracks=120, spread_m=8, noise_m=1.2, num_scenes=2),
    "few": Plan(3, DETECTION, num_scenes=1, num_steps=5, num_tracks=12),
    "gaps": Plan(4, DETECTION, num_tracks=80, absent=("bus", "barrier"), unseen=("truck",), lost=("trailer",)),
    "two": Plan(5, ("pedestrian", "bicycle"), num_tracks=60, spread_m=20),
    "sharp": Plan(6, DETECTION, num_tracks=80, noise_m=0.1, missed=0.02, false_per_step=0.5, spread_m=20),
    "coarse": Plan(7, DETECTION, num_tracks=80, digits=1, spread_m=15),
}
TRACKING_PLANS = {
    "plain": Plan(11, TRACKING, num_tracks=60),
    "crowded": Plan(12, TRACKING, num_tracks=100, spread_m=8, noise_m=0.9, num_scenes=2, switched=0.15),
    "few": Plan(13, TRACKING, num_scenes=1, num_steps=6, num_tracks=10),
    "gaps": Plan(14, TRACKING, num_tracks=70, absent=("bus",), unseen=("truck",), lost=("trailer",), missed=0.4),
    "two": Plan(15, ("pedestrian", "bicycle"), num_tracks=60, spread_m=15, switched=0.1),
    "sharp": Plan(16, TRACKING, num_tracks=70, noise_m=0.1, missed=0.02, false_per_step=0.5, spread_m=15),
    "coarse": Plan(17, TRACKING, num_tracks=70, digits=1, spread_m=15),
    "relabelled": Plan(18, TRACKING, num_tracks=70, relabelled=0.15, spread_m=15),
}
