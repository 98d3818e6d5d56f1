"""Overlap of boxes that tolerates errors of distance along the line of sight (LET), as cameras make them.

Hung et al. (2022), LET-3D-AP: Longitudinal Error Tolerant 3D Average Precision for Camera-Only 3D Detection,
https://arxiv.org/abs/2206.07705, with the constants of Waymo's `compute_detection_let_metrics_main.cc`.
"""

import numpy as np

from fbench.replay.data.arrays import Float64
from fbench.replay.geometry.iou import flat_iou

SHARE, LEAST_M = 0.1, 0.5  # Tolerated error of distance: a share of the true distance, or so many meters at least
_TINY = 1e-6


def tolerant_overlaps(truth: Float64, estimates: Float64, sensor_m: Float64) -> tuple[Float64, Float64]:
    """Return the overlap in space (B,) and the longitudinal affinity (B,) of B pairs of boxes (B, 7) as `flat_iou` has
    them, seen from sensors at `sensor_m` (B, 3).

    The estimate is moved along its line of sight to where it is nearest to the true center; the overlap is that of the
    moved box. The affinity is 1 - |error of distance| / tolerance, 0 at least, where the error is that of the
    estimate's center along the line of sight to the true one. NaN where a box isn't finite.
    """
    g, p = truth[:, :3] - sensor_m, estimates[:, :3] - sensor_m
    product = (g * p).sum(axis=1)
    distance = np.maximum(np.linalg.norm(g, axis=1), _TINY)
    # How far the estimate is along the line of sight to the true center.
    error = product / distance - distance
    affinity = np.clip(1 - np.abs(error) / np.maximum(SHARE * distance, LEAST_M), 0.0, 1.0)
    moved = estimates.copy()
    moved[:, :3] = sensor_m + p * (product / np.maximum((p * p).sum(axis=1), _TINY))[:, None]
    each = np.arange(len(truth) + 1)
    return flat_iou(truth, moved, each, each, solid=True), affinity
