"""DBSCAN: ours against scikit-learn's on the same points, in one process."""

import time
from collections.abc import Callable
from functools import partial

import numpy as np
from sklearn.cluster import DBSCAN

from fbench.pipelines.points.dbscan import dbscan

EPS_M, MIN_POINTS = 0.6, 5


def street(num: int) -> np.ndarray:
    """Points in the plane: two thirds in clusters of the size of cars, the rest scattered."""
    rng = np.random.Generator(np.random.Philox(7))
    half_width_m = np.sqrt(num) * 0.4
    centers = rng.uniform(-half_width_m, half_width_m, (max(1, num // 100), 2))
    members = centers[rng.integers(0, len(centers), 2 * num // 3)] + rng.normal(0, [1.5, 0.6], (2 * num // 3, 2))
    return np.concatenate([members, rng.uniform(-half_width_m, half_width_m, (num - len(members), 2))])


def best_s(function: Callable[[], object], repeat: int = 5) -> float:
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    dbscan(street(100), EPS_M, MIN_POINTS)  # compiles
    for num in (3_000, 10_000, 30_000, 100_000):
        points = street(num)
        reference = DBSCAN(eps=EPS_M, min_samples=MIN_POINTS)
        ours, theirs = dbscan(points, EPS_M, MIN_POINTS), reference.fit_predict(points)
        assert np.array_equal(ours < 0, theirs < 0)
        a = best_s(partial(dbscan, points, EPS_M, MIN_POINTS))
        b = best_s(partial(reference.fit, points), 2)
        print(f"dbscan, {num} points: {1e3 * a:.1f} ms, scikit-learn {1e3 * b:.1f} ms, {b / a:.1f} times as fast")


if __name__ == "__main__":
    main()
