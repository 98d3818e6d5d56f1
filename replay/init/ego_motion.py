"""The vehicle's own motion, from one radar scan or from poses."""

from collections.abc import Sequence

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.data import Pose, RadarScan
from fbench.replay.geometry.ego_velocity import EgoFit, fit_ego


def fit_scan(scan: RadarScan, body_R_sensor: Float64) -> EgoFit | None:
    """Fit the radar's motion over ground, as if its velocities were positive when receding and unambiguous.

    Args:
        scan: With radial velocities (N,) [m/s].
        body_R_sensor: Rotation (3, 3).

    Returns:
        `None` where there are too few points.
    """
    if scan.radial_velocity_mps is None:
        return None
    xyz = np.asarray(scan.xyz, np.float64)
    distance = np.sqrt((xyz**2).sum(axis=1))
    good = (distance > 1.0) & (distance < 1e6)  # neither too near for a direction nor not finite
    unit = xyz[good] / distance[good, None]
    directions = np.stack([unit[:, 0] * m[0] + unit[:, 1] * m[1] + unit[:, 2] * m[2] for m in body_R_sensor], axis=1)
    return fit_ego(directions, np.asarray(scan.radial_velocity_mps, np.float64)[good], None)


def forward_speed(poses: Sequence[Pose]) -> float | None:
    """Median speed along the body's x axis [m/s], of poses in the order of their stamps; `None`: there are too few."""
    speeds = []
    for first, second in zip(poses, poses[5:], strict=False):
        seconds = (second.stamp_ns - first.stamp_ns) / 1e9
        if 0 < seconds < 2 and np.any(first.rotation_xyzw):
            step = second.translation_m - first.translation_m
            speeds.append(float((step * first.world_T_body[:3, 0]).sum()) / seconds)
    return float(np.median(speeds)) if speeds else None
