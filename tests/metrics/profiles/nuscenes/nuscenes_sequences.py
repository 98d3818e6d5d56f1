"""Random scenes, and small ones written by hand, as sequences."""

from collections.abc import Iterable

import numpy as np
from tests.metrics.profiles.nuscenes.oracles.nuscenes_scenes import Row, Scene

from fbench.replay.data.arrays import text_array
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Objects, Sequence, Steps


def row(step: int, name: str, own: int, x: float, y: float = 0.0, **changes: object) -> Row:
    """A box of 4 x 2 x 1.5 m that stands still; `changes` are fields of it."""
    plain: Row = {
        "step": step, "name": name, "id": own, "xyz": (x, y, 0.0), "lwh": (4.0, 2.0, 1.5), "yaw": 0.0,
        "velocity": (0.0, 0.0), "attribute": "", "points": -1, "score": 0.5,
    }  # fmt: skip
    return {**plain, **changes}


def objects(rows: Iterable[Row]) -> Objects:
    """Boxes of one side; rows come in any order."""
    rows = sorted(rows, key=lambda r: r["step"])
    n = len(rows)
    velocity = np.array([r["velocity"] for r in rows], float).reshape(n, 2)
    return Objects(
        step=np.array([r["step"] for r in rows], np.int64),
        label=text_array([r["name"] for r in rows]),
        track_id=np.array([r["id"] for r in rows], np.int64),
        score=np.array([r["score"] for r in rows], float),
        center_m=np.array([r["xyz"] for r in rows], float).reshape(n, 3),
        size_lwh_m=np.array([r["lwh"] for r in rows], float).reshape(n, 3),
        yaw_rad=np.array([r["yaw"] for r in rows], float),
        velocity_mps=np.hstack([velocity, np.zeros((n, 1))]),
        num_points=np.array([r["points"] for r in rows], np.int64),
        attribute=text_array([r["attribute"] for r in rows]),
    )


def sequence(truth: Iterable[Row], results: Iterable[Row], num_steps: int = 1, name: str = "scene") -> Sequence:
    """A scene with samples every 0.5 s, seen from the origin."""
    zeros = np.zeros(num_steps, np.int64)
    steps = Steps(np.arange(num_steps), np.arange(1, num_steps + 1) * 500_000_000, zeros)
    return Sequence(name, steps, objects(truth), objects(results))


def of_scene(scene: Scene) -> Sequence:
    """A random scene."""
    n = len(scene.stamp_us)
    steps = Steps(np.arange(n), np.array(scene.stamp_us, np.int64) * 1000, np.zeros(n, np.int64))
    return Sequence(scene.name, steps, objects(scene.truth), objects(scene.results), ego_m=np.array(scene.ego))


def find(rows: list[Score], metric: str, class_: str = "all", matching: str | None = None) -> Score:
    """The one row of a metric."""
    found = [r for r in rows if r.metric == metric and r.class_ == class_ and matching in (None, r.matching)]
    assert len(found) == 1, (metric, class_, matching)
    return found[0]
