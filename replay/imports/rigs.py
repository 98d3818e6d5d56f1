"""Sensors from the matrices that datasets publish."""

import numpy as np

from fbench.replay.data import Float64, Kind, Mount
from fbench.replay.geometry.transforms import quaternion

BODY_T_OPTICAL: Float64 = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], np.float64)
"""(4, 4) from axes right, down, forward, as cameras have them, to those of bodies: forward, left, up."""


def mount_of(kind: Kind, body_T_sensor: Float64) -> Mount:
    """Return where a sensor is, by its pose (4, 4), whose rotation is made orthonormal."""
    return Mount(kind, body_T_sensor[:3, 3], quaternion(body_T_sensor[:3, :3]))


def is_rotation(R: Float64, tolerance: float = 1e-3) -> bool:
    """Tell whether a matrix (3, 3) is orthonormal up to a tolerance, as files round, and doesn't mirror."""
    # Not by BLAS, whose result depends on the machine; NaN isn't within the tolerance.
    with np.errstate(over="ignore", invalid="ignore"):
        gram = (R[:, :, None] * R[:, None, :]).sum(axis=0)
    return bool(np.abs(gram - np.eye(3)).max() <= tolerance and np.linalg.det(R) > 0)


def is_pinhole(K: Float64) -> bool:
    """Tell whether a matrix (3, 3) is of the form fx s cx / 0 fy cy / 0 0 1, with fx and fy above 0."""
    return bool(K[0, 0] > 0 and K[1, 1] > 0 and K[2, 2] == 1 and not np.tril(K, -1).any())
