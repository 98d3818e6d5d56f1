"""Cells of pixels against a plain reference."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fbench.pipelines.sensors.stereo.depth import gather


def plain(disparity, focal_baseline, per_px, body_T_camera, depth_m, bins, z_m):
    """Pixel by pixel, columns first: mean points and counts of cells, in the order of their first pixels."""
    cells = {}
    for u in range(disparity.shape[0]):
        for v in range(disparity.shape[1]):
            d = float(disparity[u, v])
            if np.isnan(d) or d <= 0 or d * depth_m[1] < focal_baseline or d * depth_m[0] > focal_baseline:
                continue
            z = focal_baseline / d
            camera = np.array([(u * per_px[0, 0] + per_px[0, 1]) * z, (v * per_px[1, 0] + per_px[1, 1]) * z, z, 1])
            point = (body_T_camera @ camera)[:3]
            if not z_m[0] <= point[2] < z_m[1]:
                continue
            key = (u // int(bins[0]), int(d / bins[1]), int((point[2] - z_m[0]) / bins[2]))
            cells.setdefault(key, []).append(point)
    # Keys begin with their columns' number, and dicts keep the order of first pixels.
    return [np.mean(points, axis=0) for points in cells.values()], [len(points) for points in cells.values()]


@settings(deadline=None, max_examples=150)
@given(st.integers(0, 2**32 - 1))
def test_cells_as_written_down(seed):
    rng = np.random.default_rng(seed)
    size = rng.integers(1, 12, 2)
    disparity = rng.choice([rng.uniform(0.5, 40), np.nan, 0.0, -1.0, np.inf, 3.0, 16.5], size).astype(np.float32)
    disparity = np.where(rng.random(size) < 0.6, rng.uniform(0.5, 40, size), disparity).astype(np.float32)
    per_px = np.array([[1 / 200, -rng.uniform(0, 12) / 200], [1 / 200, -rng.uniform(0, 12) / 200]])
    body_T_camera = np.eye(4)
    body_T_camera[:3] = [[0, 0, 1, 1.5], [-1, 0, 0, 0.2], [0, -1, 0, 1.0]]
    depth_m = np.array([rng.uniform(0.5, 5), rng.uniform(10, 60)])
    bins = np.array([rng.integers(1, 6), rng.choice([0.5, 2.0]), rng.choice([0.3, 1.0])], np.float64)
    z_m = np.array([-5.1, 7.2])
    xyz, num = gather(disparity, 80.0, per_px, body_T_camera, depth_m, bins, z_m)
    expected, counts = plain(disparity, 80.0, per_px, body_T_camera, depth_m, bins, z_m)
    assert num.tolist() == counts
    if counts:
        np.testing.assert_allclose(xyz, expected, rtol=1e-9, atol=1e-9)
