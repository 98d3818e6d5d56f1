"""Compiled motion of many points."""

import numpy as np

from fbench.replay.arrays import Array, Float64
from fbench.replay.kernels import kernel


@kernel
def moved(m: Float64, xyz: Array) -> Float64:
    """Move points (N, 3) by a matrix (4, 4), bit by bit as `transform` does it on whole columns."""
    result = np.empty((len(xyz), 3))
    for row in range(len(xyz)):
        x, y, z = np.float64(xyz[row, 0]), np.float64(xyz[row, 1]), np.float64(xyz[row, 2])
        for i in range(3):
            result[row, i] = x * m[i, 0] + y * m[i, 1] + z * m[i, 2] + m[i, 3]
    return result
