"""Which of many things are near a place: a grid of cells on the ground."""

from math import floor
from typing import NamedTuple

import numpy as np

from fbench.replay.arrays import Array, Float64
from fbench.replay.kernels import kernel

_CELL_M = 4.0
_CELLS = 80
"""Along each side: 320 m."""


class Grid(NamedTuple):
    """Cells around a place; those of a row along y come one after the other."""

    x_m: float
    y_m: float
    """Its corner."""
    start: Array
    """(C + 1,) int64: where in `items` a cell's begin."""
    items: Array
    """Indices of what reaches into each cell, ascending."""


def grid_around(x_m: float, y_m: float, center_m: Float64, radius_m: Float64) -> Grid:
    """Return the cells around (x, y) with the discs that reach into them: centres (N, 2), radii (N,)."""
    corner = (x_m - _CELLS * _CELL_M / 2, y_m - _CELLS * _CELL_M / 2)
    low = np.floor((center_m - corner - radius_m[:, None]) / _CELL_M).astype(np.int64)
    high = np.floor((center_m - corner + radius_m[:, None]) / _CELL_M).astype(np.int64)
    low, high = np.clip(low, 0, _CELLS), np.clip(high, -1, _CELLS - 1)
    start, items = _filled(low, high)
    return Grid(corner[0], corner[1], start, items)


@kernel
def cell_of(corner_x_m: float, corner_y_m: float, x_m: float, y_m: float) -> int:
    """Return the cell of a place in the world, -1 outside, of a grid with this corner."""
    i, j = floor((x_m - corner_x_m) / _CELL_M), floor((y_m - corner_y_m) / _CELL_M)
    return int(i) * _CELLS + int(j) if 0 <= i < _CELLS and 0 <= j < _CELLS else -1


@kernel
def _filled(low: Array, high: Array) -> tuple[Array, Array]:
    start = np.zeros(_CELLS * _CELLS + 1, np.int64)
    for n in range(len(low)):
        for i in range(low[n, 0], high[n, 0] + 1):
            for j in range(low[n, 1], high[n, 1] + 1):
                start[i * _CELLS + j + 1] += 1
    start = np.cumsum(start)
    following, items = start[:-1].copy(), np.zeros(start[-1], np.int64)
    for n in range(len(low)):
        for i in range(low[n, 0], high[n, 0] + 1):
            for j in range(low[n, 1], high[n, 1] + 1):
                items[following[i * _CELLS + j]] = n
                following[i * _CELLS + j] += 1
    return start, items
