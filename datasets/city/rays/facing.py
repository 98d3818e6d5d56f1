"""Normals of what rays hit."""

import math

import numpy as np

from fbench.replay.arrays import Array, Float32, Float64, Int64
from fbench.replay.kernels import kernel


@kernel
def facing_normals(
    body: Array, triangle: Array, direction: Float32, offset_s: Float64, bodies: Float64, first: Int64,
    normals: Float32,
) -> Float32:  # fmt: skip
    """Return unit normals (N, 3) in the world, towards where rays come from; 0 for misses.

    `normals` are those of all meshes in their own coordinates, one mesh after the other; `first` (A,) is where the
    mesh of each body begins, and the static world's are the first. `bodies` (A, 8) as in `rays_at_body`.
    """
    facing = np.zeros((len(body), 3), np.float32)
    cos, sin = np.cos(bodies[:, 3]), np.sin(bodies[:, 3])
    for k in range(len(body)):
        i = body[k]
        if i < -1:
            continue
        n = normals[triangle[k] + (first[i] if i >= 0 else 0)]
        x, y, z = float(n[0]), float(n[1]), float(n[2])
        if i >= 0:
            c, s = cos[i], sin[i]
            if len(offset_s):
                yaw = bodies[i, 3] + bodies[i, 7] * offset_s[k]
                c, s = math.cos(yaw), math.sin(yaw)
            x, y = c * x - s * y, s * x + c * y
        sign = -1.0 if x * direction[k, 0] + y * direction[k, 1] + z * direction[k, 2] > 0 else 1.0
        facing[k, 0], facing[k, 1], facing[k, 2] = sign * x, sign * y, sign * z
    return facing
