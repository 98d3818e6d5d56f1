"""DBSCAN: ours against scikit-learn's on the same points, in one process and on one core.

Times are CPU times, so that ratios hold on a busy machine, too. Where Open3D is installed, it is compared as well.
"""

import importlib.util
import time
from functools import partial

import numpy as np
from common import best_s
from sklearn.cluster import DBSCAN

from fbench.pipelines.sensors.points.dbscan import dbscan

EPS_M, MIN_POINTS = 0.6, 5
SIZES = (3_000, 10_000, 30_000, 100_000, 300_000)


def street(num: int, num_axes: int = 2, spacing_m: float = 0.4) -> np.ndarray:
    """Points at a density that doesn't depend on `num`: two thirds in clusters of a car's size, the rest scattered."""
    rng = np.random.Generator(np.random.Philox(7))
    half_width_m = np.sqrt(num) * spacing_m
    extent_m = np.array([half_width_m, half_width_m, 2.0][:num_axes])
    centers = rng.uniform(-extent_m, extent_m, (max(1, num // 100), num_axes))
    spread_m = [1.5, 0.6, 0.5][:num_axes]
    members = centers[rng.integers(0, len(centers), 2 * num // 3)] + rng.normal(0, spread_m, (2 * num // 3, num_axes))
    return np.concatenate([members, rng.uniform(-extent_m, extent_m, (num - len(members), num_axes))])


def compare(name: str, points: np.ndarray) -> float:
    """Print times for one cloud, and return ours [s]."""
    reference = DBSCAN(eps=EPS_M, min_samples=MIN_POINTS)
    ours, theirs = dbscan(points, EPS_M, MIN_POINTS), reference.fit_predict(points)
    core = reference.core_sample_indices_
    assert np.array_equal(ours < 0, theirs < 0)
    partition = np.unique(np.column_stack([ours[core], theirs[core]]), axis=0)
    assert len(partition) == ours.max() + 1 == theirs.max() + 1
    a = best_s(partial(dbscan, points, EPS_M, MIN_POINTS), 9, time.process_time)
    b = best_s(partial(reference.fit, points), 3, time.process_time)
    text = f"dbscan, {name}, {len(points)} points: {1e3 * a:.1f} ms, scikit-learn {1e3 * b:.1f} ms"
    print(f"{text}, {b / a:.1f} times as fast{open3d(points, a)}")
    return a


def open3d(points: np.ndarray, ours_s: float) -> str:
    """Compare with Open3D's, which knows points in space only; its result isn't checked."""
    if importlib.util.find_spec("open3d") is None:
        return ""
    from open3d.geometry import PointCloud
    from open3d.utility import Vector3dVector

    padded = np.zeros((len(points), 3))
    padded[:, : points.shape[1]] = points
    cloud = PointCloud(Vector3dVector(padded))
    theirs = best_s(partial(cloud.cluster_dbscan, EPS_M, MIN_POINTS), 3, time.process_time)
    return f"; Open3D {1e3 * theirs:.1f} ms, {theirs / ours_s:.1f} times"


def main() -> None:
    start = time.process_time()
    dbscan(street(100), EPS_M, MIN_POINTS)
    print(f"first call, compiled or from the cache: {time.process_time() - start:.1f} s")
    times = {num: compare("plane", street(num)) for num in SIZES}
    growth = np.log(times[300_000] / times[10_000]) / np.log(30)
    ratio = times[300_000] / times[10_000]
    print(f"from 10,000 to 300,000 points: {ratio:.0f} times, points to the power {growth:.2f}")
    compare("plane, ten times as dense", street(30_000, spacing_m=0.4 / np.sqrt(10)))
    compare("space", street(30_000, num_axes=3))
    points = street(30_000)
    radii = EPS_M * np.maximum(1.0, np.hypot(*points.T) / 20.0)
    adaptive = best_s(partial(dbscan, points, radii, MIN_POINTS), 5, time.process_time)
    print(f"dbscan, plane, radius growing beyond 20 m, 30000 points: {1e3 * adaptive:.1f} ms")


if __name__ == "__main__":
    main()
