"""Where an image needs more than one ray a pixel."""

import numpy as np

from fbench.datasets.city.camera.samples import HitArrays, Samples
from fbench.replay.arrays import Array, Bool, Float32, Int64
from fbench.replay.kernels import kernel

_APART_PX = 1 / 3
"""How far from an edge pixel's centre its two further rays go, in both directions: the three are evenly spread."""
_CONTRAST, _FAINT = 0.06, 0.01
"""Share by which the light on both sides of an edge must differ, and by how much of white, for it to be seen."""
_SAME_WAY, _APART_M, _APART = 0.93, 0.05, 0.003
"""Cosine between normals of one surface; how far, and how far a metre of range, hits lie off its plane."""


def edge_pixels(samples: Samples, linear: Float32, width: int) -> Int64:
    """Indices of pixels that don't show the same surface, in the same light, as a neighbour below, above or beside, and
    differ from it in their light (N, 3) so that one can see it.
    """
    return np.flatnonzero(_edges(samples.arrays, linear, width))


def jittered(uv: Float32, pixels: Int64, width: int) -> Float32:
    """Places (2 E, 2) of the further rays: those of the first pixel, of the second ...; on one diagonal or, in every
    other pixel, the other, so that no direction of edges is worse than others.
    """
    up = np.where((pixels // width + pixels % width) % 2 == 0, _APART_PX, -_APART_PX).astype(np.float32)
    right = np.full_like(up, _APART_PX)
    move = np.stack([right, up, -right, -up], axis=1).reshape(-1, 2, 2)
    return (uv[pixels][:, None] + move).reshape(-1, 2)


@kernel
def _edges(hits: HitArrays, linear: Float32, width: int) -> Bool:
    body, triangle, material, lit = hits.body, hits.triangle, hits.material, hits.lit
    range_m, normal, direction = hits.range_m, hits.normal, hits.direction
    edges = np.zeros(len(body), np.bool_)
    for i in range(len(body)):
        for j in (i + 1, i + width):
            if (j == i + 1 and j % width == 0) or j >= len(body) or not _contrasts(linear, i, j):
                continue
            differs = body[i] != body[j] or material[i] != material[j] or lit[i] != lit[j]
            if differs or (triangle[i] != triangle[j] and _bends(range_m, normal, direction, i, j)):
                edges[i] = edges[j] = True
    return edges


@kernel
def _bends(range_m: Array, normal: Array, direction: Array, i: int, j: int) -> bool:
    """Tell whether two hits don't lie in one plane."""
    turn, apart = 0.0, 0.0
    for axis in range(3):
        turn += normal[i, axis] * normal[j, axis]
        apart += normal[i, axis] * (direction[j, axis] * range_m[j] - direction[i, axis] * range_m[i])
    return turn < _SAME_WAY or abs(apart) > _APART_M + _APART * range_m[i]


@kernel
def _contrasts(linear: Float32, i: int, j: int) -> bool:
    for c in range(3):
        a, b = linear[i, c], linear[j, c]
        if abs(a - b) > _CONTRAST * min(a, b) + _FAINT:
            return True
    return False
