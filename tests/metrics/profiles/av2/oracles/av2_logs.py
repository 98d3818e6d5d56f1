"""Random logs in plain numbers: read by the oracle in av2-api's environment and by the tests in fbench's."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

Row = dict[str, Any]


@dataclass
class Log:
    """Sweeps of one log, and boxes as rows: step, name, id, xyz, lwh, yaw, points, score; in the ego's coordinates."""

    name: str
    num_steps: int
    truth: list[Row] = field(default_factory=list)
    results: list[Row] = field(default_factory=list)


@dataclass(frozen=True)
class Plan:
    """What random logs are like."""

    seed: int
    num_logs: int = 3
    num_steps: int = 12
    num_tracks: int = 24
    spread_m: float = 40.0
    noise_m: float = 0.7
    missed: float = 0.15
    false_per_step: float = 4.0
    switched: float = 0.05
    classes: tuple[str, ...] = ("regular_vehicle", "pedestrian", "bus", "bollard")
    unseen: tuple[str, ...] = ()  # Classes without results
    absent: tuple[str, ...] = ()  # Classes without truth


PLANS = {
    "usual": Plan(1),
    "far": Plan(2, spread_m=160.0, noise_m=1.5),
    "crowded": Plan(3, classes=("pedestrian",), num_tracks=60, spread_m=8.0, noise_m=1.0, num_logs=1),
    "many": Plan(4, classes=("regular_vehicle",), false_per_step=130.0, num_logs=1, num_steps=3),
    "lacking": Plan(5, unseen=("bus",), absent=("bollard",), missed=0.6),
    "sparse": Plan(7, num_logs=4, num_tracks=8, missed=0.5, false_per_step=0.5),
    "bad": Plan(6, noise_m=6.0, missed=0.4, switched=0.3),
}


def logs_of(plan: Plan) -> list[Log]:
    """Return random logs; the same for the same plan, wherever numpy's Philox is."""
    rng = np.random.Generator(np.random.Philox(plan.seed))
    return [_log(plan, f"log-{i}", rng) for i in range(plan.num_logs)]


def _log(plan: Plan, name: str, rng: np.random.Generator) -> Log:
    log, next_id = Log(name, plan.num_steps), 1000
    for track in range(plan.num_tracks):
        kind = plan.classes[track % len(plan.classes)]
        start, end = sorted(rng.integers(0, plan.num_steps + 1, 2))
        place = np.append(rng.uniform(-plan.spread_m, plan.spread_m, 2), rng.uniform(-1, 1))
        yaw, speed, quality, own = rng.uniform(-np.pi, np.pi), rng.uniform(0, 1), rng.uniform(0.2, 1.0), next_id
        size = rng.uniform(0.5, 5.0, 3)
        next_id += 1
        for step in range(start, end):
            at = place + (step - start) * speed * np.array([np.cos(yaw), np.sin(yaw), 0.0])
            points = int(rng.integers(0, 6))
            if kind not in plan.absent:
                log.truth.append(_row(step, kind, track, at, size, yaw, points, 0.0))
            if rng.random() < plan.missed or kind in plan.unseen:
                continue
            if rng.random() < plan.switched:
                own, next_id = next_id, next_id + 1
            turned = yaw + rng.normal(0, 0.2) + (np.pi if rng.random() < 0.1 else 0.0)
            moved, scaled = at + rng.normal(0, plan.noise_m, 3), size * rng.uniform(0.7, 1.3, 3)
            score = float(1 / (1 + np.exp(-4 * (quality + rng.normal(0, 0.1)) + 2)))  # no two are equal
            log.results.append(_row(step, kind, own, moved, scaled, turned, -1, score))
    kinds = [name for name in plan.classes if name not in plan.unseen]
    for step in range(plan.num_steps):
        for _ in range(rng.poisson(plan.false_per_step)):
            at = np.append(rng.uniform(-plan.spread_m, plan.spread_m, 2), 0.0)
            kind, size = str(rng.choice(kinds)), rng.uniform(0.5, 5.0, 3)
            log.results.append(_row(step, kind, next_id, at, size, 0.0, -1, float(rng.uniform(0.01, 0.6))))
            next_id += 1
    for rows in (log.truth, log.results):
        rows.sort(key=lambda row: row["step"])
    return log


def _row(step: int, name: str, own: int, xyz: Any, lwh: Any, yaw: float, points: int, score: float) -> Row:
    place, size = (tuple(float(v) for v in values) for values in (xyz, lwh))
    return {
        "step": int(step), "name": name, "id": int(own), "xyz": place, "lwh": size, "yaw": float(yaw),
        "points": points, "score": score,
    }  # fmt: skip
