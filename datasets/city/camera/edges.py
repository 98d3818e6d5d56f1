"""Where an image needs more than one ray a pixel."""

import numpy as np

from fbench.datasets.city.camera.samples import HitArrays, Samples
from fbench.replay.arrays import Array, Bool, Float32, Int64
from fbench.replay.kernels import kernel

_JITTER_PX = np.array([[0.31, -0.18], [-0.31, -0.18], [0.0, 0.36]], np.float32)
NUM_MORE = len(_JITTER_PX)
"""How many more rays an edge pixel gets; with the first they lie evenly around its centre."""
_SAME_WAY, _APART_M, _APART = 0.93, 0.05, 0.003
"""Cosine between normals of one surface; how far, and how far a metre of range, hits lie off its plane."""


def edge_pixels(samples: Samples, width: int) -> Int64:
    """Indices of pixels that don't show the same surface, in the same light, as a neighbour below, above or beside."""
    return np.flatnonzero(_edges(samples.arrays, width))


def jittered(uv: Float32, pixels: Int64) -> Float32:
    """Places (3 E, 2) of the further rays: those of the first pixel, of the second ..."""
    return (uv[pixels][:, None] + _JITTER_PX).reshape(-1, 2)


@kernel
def _edges(hits: HitArrays, width: int) -> Bool:
    body, triangle, material, lit = hits.body, hits.triangle, hits.material, hits.lit
    range_m, normal, direction = hits.range_m, hits.normal, hits.direction
    edges = np.zeros(len(body), np.bool_)
    for i in range(len(body)):
        for j in (i + 1, i + width):
            if (j == i + 1 and j % width == 0) or j >= len(body):
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
