"""Copies of one mesh at many places."""

import numpy as np

from fbench.datasets.city.mesh import Mesh
from fbench.replay.arrays import Array, Float64


def copies(
    mesh: Mesh, position_m: Float64, yaw_rad: Float64, scale: Float64, tint: Float64, lamp_base: Array | None = None
) -> Mesh:
    """Place N copies of a mesh.

    Args:
        mesh: in its own coordinates, x forward, z up.
        position_m: (N, 3) where its origin comes to lie.
        yaw_rad: (N,) about z.
        scale: (N, 3) along its own axes, applied first; positive.
        tint: (N, 3) factors on its colours, of which none exceeds 1 afterwards.
        lamp_base: (N,) what is added to the numbers of its lamps; -1: this copy's lamps can't be switched.
    """
    num = len(position_m)
    cos, sin = np.cos(yaw_rad)[:, None], np.sin(yaw_rad)[:, None]
    own = mesh.vertices_m[None].astype(np.float64) * scale[:, None]
    x, y = own[..., 0], own[..., 1]
    moved = np.stack([x * cos - y * sin, x * sin + y * cos, own[..., 2]], axis=-1) + position_m[:, None]
    first = np.arange(num, dtype=np.int32)[:, None, None] * len(mesh.vertices_m)
    colors = np.minimum(mesh.color[None] * tint[:, None], 1.0).astype(np.float32)
    return Mesh(
        moved.reshape(-1, 3).astype(np.float32),
        (mesh.triangles[None] + first).reshape(-1, 3).astype(np.int32),
        np.tile(mesh.material, num),
        colors.reshape(-1, 3),
        _lamps(mesh.lamp, np.zeros(num, np.int32) if lamp_base is None else lamp_base),
    )


def _lamps(lamp: Array, base: Array) -> Array:
    own = (lamp[None] >= 0) & (base[:, None] >= 0)
    return np.where(own, lamp[None] + base[:, None], -1).astype(np.int32).reshape(-1)
