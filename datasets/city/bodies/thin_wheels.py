"""Wheels of two-wheelers: a tyre around a rim that one sees through."""

import numpy as np

from fbench.datasets.city.bodies.paints import TYRE
from fbench.datasets.city.bodies.shell import shell, tube
from fbench.datasets.city.mesh import Mesh
from fbench.datasets.city.shapes import Skin
from fbench.replay.arrays import Array


def thin_wheel(x_m: float, radius_m: float, width_m: float, rim: Skin) -> list[Mesh]:
    """Return a bicycle's wheel at `x_m`, with spokes; half of the ring's depth is rubber."""
    half, depth = width_m / 2, 1.8 * width_m
    rows = np.array([(radius_m, 0.0), (radius_m - 0.5 * depth, half), (radius_m - depth, 0),
                     (radius_m - 0.5 * depth, -half), (radius_m, 0.0)])  # fmt: skip
    ring = _ring(x_m, radius_m, rows, 18, np.array([0, 1, 1, 0]), rim)
    return [ring, *_spokes(x_m, radius_m, radius_m - depth, 0.005, 4, rim)]


def thick_wheel(x_m: float, radius_m: float, width_m: float, rim: Skin) -> list[Mesh]:
    """Return a motorcycle's wheel at `x_m`, with a cast rim."""
    half, inner = width_m / 2, 0.62 * radius_m
    rows = np.array([(radius_m, 0.45 * half), (0.82 * radius_m, half), (inner, 0.0),
                     (0.82 * radius_m, -half), (radius_m, -0.45 * half), (radius_m, 0.45 * half)])  # fmt: skip
    ring = _ring(x_m, radius_m, rows, 14, np.array([0, 1, 1, 0, 0]), rim)
    return [ring, *_spokes(x_m, radius_m, inner + 0.01, 0.022, 3, rim)]


def _ring(x: float, radius: float, rows: Array, num: int, skins: Array, rim: Skin) -> Mesh:
    """Turn an outline (R, 2) of radius and y about the axle."""
    angle = np.arange(num) * (2 * np.pi / num) - np.pi / 2
    rings = np.stack([np.column_stack([x - r * np.cos(angle), np.full(num, y), radius + r * np.sin(angle)])
                      for r, y in rows])  # fmt: skip
    return shell(rings, skins[:, None] + np.zeros(num, int), [TYRE, rim], None)


def _spokes(x: float, z: float, reach: float, radius: float, num: int, rim: Skin) -> list[Mesh]:
    """Bars through the hub, and the hub."""
    parts = [tube([(x, -0.05, z), (x, 0.05, z)], np.array([0.03, 0.03]), 6, [rim])]
    for angle in (np.arange(num) + 0.5) * np.pi / num:
        step = reach * np.array([np.cos(angle), 0.0, np.sin(angle)])
        middle = np.array([x, 0.0, z])
        parts.append(tube([middle - step, middle + step], np.array([radius, radius]), 4, [rim]))
    return parts
