"""Rotations of single boxes."""

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.replay.boxfiles.rows import Triple
from fbench.replay.errors import LogError


def angles(x: float, y: float, z: float, w: float, where: str) -> Triple:
    """Return yaw, pitch, roll [rad] of a quaternion, R = Rz(yaw) Ry(pitch) Rx(roll); NaN where it isn't finite.

    Raises:
        LogError: where it is zero.
    """
    xyzw = np.array([x, y, z, w])
    if not np.isfinite(xyzw).all():
        return np.nan, np.nan, np.nan
    norm = float(np.hypot(np.hypot(x, y), np.hypot(z, w)))
    if norm == 0:
        raise LogError(f"{where}: rotation is the quaternion 0 0 0 0")
    if x == y == 0:
        return float(2 * np.arctan2(z, w)), 0.0, 0.0
    yaw, pitch, roll = Rotation.from_quat(xyzw / norm).as_euler("ZYX", suppress_warnings=True)
    return float(yaw), float(pitch), float(roll)
