"""Compiled loops of DBSCAN over cells whose points are all neighbours; cells and points are those of `grid_kernel`."""

import numpy as np

from fbench.pipelines.points.grid_kernel import Pairs
from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.kernels import kernel

SMALL = 4
"""Of cells with so few points it is cheaper to look at the points than at bounds first."""


@kernel
def _near(points: Float64, i: int, j: int) -> bool:
    x = points[i, 0] - points[j, 0]
    y = points[i, 1] - points[j, 1]
    z = points[i, 2] - points[j, 2]
    radius = min(points[i, 3], points[j, 3])
    near: bool = x * x + y * y + z * z <= radius * radius
    return near


@kernel
def _count(points: Float64, first: Int64, a: int, b: int, count: Int64) -> None:
    """Count neighbours between two cells."""
    for i in range(first[a], first[a + 1]):
        for j in range(first[b], first[b + 1]):
            near = np.int64(_near(points, i, j))  # added without a branch, which would be hard to predict
            count[i] += near
            count[j] += near


@kernel
def _count_one(points: Float64, first: Int64, a: int, b: int, count: Int64, enough: int) -> None:
    """As `_count`, for the points of `a` only, up to `enough`."""
    for i in range(first[a], first[a + 1]):
        for j in range(first[b], first[b + 1]):
            if count[i] >= enough:
                break
            if _near(points, i, j):
                count[i] += 1


@kernel
def core_points(points: Float64, first: Int64, pairs: Pairs, min_points: int) -> Bool:
    """Tell which points (N, 4), sorted by cell, have at least `min_points` neighbours, themselves included.

    `first` (M + 1,) is the row of each cell's first point; `pairs` (P, 2) of cells may hold neighbours.
    """
    count = np.empty(len(points), np.int64)
    for c in range(len(first) - 1):
        for i in range(first[c], first[c + 1]):
            count[i] = first[c + 1] - first[c]
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        a_full, b_full = first[a + 1] - first[a] >= min_points, first[b + 1] - first[b] >= min_points
        if a_full and not b_full:
            _count_one(points, first, b, a, count, min_points)
        elif b_full and not a_full:
            _count_one(points, first, a, b, count, min_points)
        elif not a_full:
            _count(points, first, a, b, count)
    return count >= min_points


@kernel
def _root(parent: Int64, c: int) -> int:
    while parent[c] != c:
        parent[c] = parent[parent[c]]
        c = parent[c]
    return c


@kernel
def _reaches(points: Float64, i: int, bounds: Float64, b: int) -> bool:
    """Tell whether the bounds of a cell lie within the radius of a point."""
    x = max(bounds[b, 0] - points[i, 0], points[i, 0] - bounds[b, 3], 0.0)
    y = max(bounds[b, 1] - points[i, 1], points[i, 1] - bounds[b, 4], 0.0)
    z = max(bounds[b, 2] - points[i, 2], points[i, 2] - bounds[b, 5], 0.0)
    near: bool = x * x + y * y + z * z <= points[i, 3] * points[i, 3]
    return near


@kernel
def _linked(points: Float64, core: Bool, first: Int64, bounds: Float64, a: int, b: int) -> bool:
    """Tell whether a core point of one cell is a neighbour of one of the other."""
    is_small = first[b + 1] - first[b] <= SMALL
    for i in range(first[a], first[a + 1]):
        if not core[i] or not (is_small or _reaches(points, i, bounds, b)):
            continue
        for j in range(first[b], first[b + 1]):
            if core[j] and _near(points, i, j):
                return True
    return False


@kernel
def cluster_cells(points: Float64, core: Bool, first: Int64, bounds: Float64, pairs: Pairs) -> tuple[Int64, Int64]:
    """Join cells whose core points are neighbours.

    Returns the root of each cell's cluster (M,), -1 where the cell has no core point, and the lexicographically
    smallest core point of each root (M,), -1 elsewhere.
    """
    num = len(first) - 1
    parent, smallest = np.full(num, -1), np.full(num, -1)
    for c in range(num):
        for i in range(first[c], first[c + 1]):
            if core[i]:
                parent[c] = c
                break
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        if parent[a] < 0 or parent[b] < 0:
            continue
        one, other = _root(parent, a), _root(parent, b)
        if one != other and _linked(points, core, first, bounds, a, b):
            parent[one] = other
    for c in range(num):
        if parent[c] >= 0:
            parent[c] = _root(parent, c)
            _take_smallest(points, core, first, c, parent[c], smallest)
    return parent, smallest


@kernel
def _take_smallest(points: Float64, core: Bool, first: Int64, c: int, root: int, smallest: Int64) -> None:
    for i in range(first[c], first[c + 1]):
        if core[i] and (smallest[root] < 0 or _is_smaller(points, i, smallest[root])):
            smallest[root] = i


@kernel
def _is_smaller(points: Float64, i: int, j: int) -> bool:
    for axis in range(3):
        if points[i, axis] != points[j, axis]:
            smaller: bool = points[i, axis] < points[j, axis]
            return smaller
    return False


@kernel
def labels(points: Float64, core: Bool, first: Int64, number: Int64, pairs: Pairs) -> Int64:
    """Give points the number of their cell (M,), or the lowest of neighbouring core points; -1 where there is none."""
    result = np.empty(len(points), np.int64)
    for c in range(len(first) - 1):
        for i in range(first[c], first[c + 1]):
            result[i] = number[c]
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        if number[b] >= 0 and (number[a] < 0 or number[b] < number[a]):
            _lower(points, core, first, a, b, number[b], result)
        elif number[a] >= 0 and (number[b] < 0 or number[a] < number[b]):
            _lower(points, core, first, b, a, number[a], result)
    return result


@kernel
def _lower(points: Float64, core: Bool, first: Int64, a: int, b: int, number: int, result: Int64) -> None:
    """Give points of `a` that aren't core the number of `b` where it is lower and a core point there is a neighbour."""
    for i in range(first[a], first[a + 1]):
        if core[i] or 0 <= result[i] <= number:
            continue
        for j in range(first[b], first[b + 1]):
            if core[j] and _near(points, i, j):
                result[i] = number
                break
