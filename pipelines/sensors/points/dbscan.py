"""DBSCAN whose result doesn't depend on the order of the points, compiled."""

import numpy as np

from fbench.pipelines.sensors.points import grid
from fbench.pipelines.sensors.points.grid import Pairs, find_root
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.geometry.kernels import kernel, kernel_part

SMALL = 4  # Of cells with so few points it is cheaper to look at the points than at bounds first


@kernel_part
def _near(points: Float64, i: int, j: int) -> bool:
    x = points[i, 0] - points[j, 0]
    y = points[i, 1] - points[j, 1]
    z = points[i, 2] - points[j, 2]
    radius = min(points[i, 3], points[j, 3])
    near: bool = x * x + y * y + z * z <= radius * radius
    return near


@kernel_part
def _count(points: Float64, first: Int64, a: int, b: int, count: Int64) -> None:
    for i in range(first[a], first[a + 1]):
        for j in range(first[b], first[b + 1]):
            near = np.int64(_near(points, i, j))  # added without a branch, which would be hard to predict
            count[i] += near
            count[j] += near


@kernel_part
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
    """Tell which points (N, 4), sorted by cell, have at least `min_points` neighbors, themselves included.

    `first` (M + 1,) is the row of each cell's first point; `pairs` (P, 2) of cells may hold neighbors.
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


@kernel_part
def _reaches(points: Float64, i: int, bounds: Float64, b: int) -> bool:
    x = max(bounds[b, 0] - points[i, 0], points[i, 0] - bounds[b, 3], 0.0)
    y = max(bounds[b, 1] - points[i, 1], points[i, 1] - bounds[b, 4], 0.0)
    z = max(bounds[b, 2] - points[i, 2], points[i, 2] - bounds[b, 5], 0.0)
    near: bool = x * x + y * y + z * z <= points[i, 3] * points[i, 3]
    return near


@kernel_part
def _are_linked(points: Float64, core: Bool, first: Int64, bounds: Float64, a: int, b: int) -> bool:
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
    """Join cells whose core points are neighbors.

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
        one, other = find_root(parent, a), find_root(parent, b)
        if one != other and _are_linked(points, core, first, bounds, a, b):
            parent[one] = other
    for c in range(num):
        if parent[c] >= 0:
            root = parent[c] = find_root(parent, c)
            smallest[root] = _find_smallest(points, core, first[c], first[c + 1], smallest[root])
    return parent, smallest


@kernel_part
def _find_smallest(points: Float64, core: Bool, begin: int, end: int, best: int) -> int:
    for i in range(begin, end):
        if core[i] and (best < 0 or _is_smaller(points, i, best)):
            best = i
    return best


@kernel_part
def _is_smaller(points: Float64, i: int, j: int) -> bool:
    for axis in range(3):
        if points[i, axis] != points[j, axis]:
            smaller: bool = points[i, axis] < points[j, axis]
            return smaller
    return False


@kernel
def labels(points: Float64, core: Bool, first: Int64, number: Int64, pairs: Pairs) -> Int64:
    """Give points the number of their cell (M,), or the lowest of neighboring core points; -1 where there is none."""
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


@kernel_part
def _lower(points: Float64, core: Bool, first: Int64, a: int, b: int, number: int, result: Int64) -> None:
    """Give points of `a` that aren't core the number of `b` where it is lower and a core point there is a neighbor."""
    for i in range(first[a], first[a + 1]):
        if core[i] or 0 <= result[i] <= number:
            continue
        for j in range(first[b], first[b + 1]):
            if core[j] and _near(points, i, j):
                result[i] = number
                break


_SHRUNK = 1 - 1e-9
"""Cells are a hair smaller than need be, so that rounding hardly ever makes their points more than a radius apart."""
_LEAST_EPS, _MOST_EPS = 1e-150, 1e150  # Radii are clipped here, where squares still are numbers


def dbscan(points: Array, eps: float | Float64, min_points: int) -> Int64:
    """Cluster points (N, 1 to 3); returns cluster numbers (N,), -1 for noise.

    As defined by Ester et al., KDD 1996: a point is core when at least `min_points` points, itself included, lie
    within `eps` (closed ball); clusters are the connected components of core points. Clusters are numbered by their
    lexicographically smallest core point, and a border point belongs to the lowest-numbered cluster that reaches it.
    With a radius for each point, `eps` (N,), two points are neighbors where their distance is at most the smaller
    of their radii. Points that aren't finite are noise.

    The grid is that of Gunawan, 2013, and de Berg et al., ISAAC 2017: in cells with a diagonal of `eps` at least
    `min_points` points are core without being looked at, and clusters are joined cell by cell. Radii that vary by more
    than a factor of two have a grid for each doubling. Raises ConfigError where an `eps` isn't positive or `min_points`
    is below 1.
    """
    radii = np.asarray(eps, np.float64)
    if not np.all(radii > 0) or min_points < 1:
        raise ConfigError(f"dbscan: expected eps > 0 and min_points >= 1, got {eps} and {min_points}")
    result = np.full(len(points), -1)
    if not np.isfinite(points).all():
        is_finite = np.isfinite(points).all(axis=1)
        result[is_finite] = dbscan(points[is_finite], radii[is_finite] if radii.ndim else eps, min_points)
    elif len(points):
        result[:] = _clusters(points, np.clip(radii, _LEAST_EPS, _MOST_EPS), min_points)
    return result


def _clusters(finite: Array, radii: Float64, min_points: int) -> Int64:
    num, num_axes = finite.shape
    rows = np.zeros((num, 4))  # x, y, z, radius; zeros for axes that the points lack
    rows[:, 3 - num_axes : 3] = finite
    rows[:, 3] = radii
    level = np.broadcast_to(np.frexp(radii / radii.min())[1].astype(np.int64) - 1, num)
    edge = float(radii.min()) / np.sqrt(num_axes) * _SHRUNK
    order, points, cells, first, bounds = _grid(rows, grid.cell_numbers(rows, level, edge))
    pairs = _pairs(cells, bounds, edge)
    core = core_points(points, first, pairs, min_points)
    root, smallest = cluster_cells(points, core, first, bounds, pairs)
    # The clusters of cells are numbered by their smallest core point.
    roots = np.flatnonzero(smallest >= 0)
    number = np.full(len(root) + 1, -1)  # the last for cells without a cluster, whose root is -1
    number[roots[np.lexsort(points[smallest[roots], 2::-1].T)]] = np.arange(len(roots))
    result = np.empty(num, np.int64)
    result[order] = labels(points, core, first, number[root], pairs)
    return result


def _grid(rows: Float64, numbers: Int64) -> tuple[Int64, Float64, Int64, Int64, Float64]:
    """Sort points (N, 4) by cell; returns their order (N,), themselves, and cells, their first points and bounds."""
    order = grid.lexicographic(numbers)
    points, cells, first = grid.cells_of(rows, numbers, order)
    bounds, is_small = grid.cell_bounds(points, first)
    if is_small.all():
        return order, points, cells, first, bounds
    # Far out, where a cell is no wider than rounding, only equal points are sure to be neighbors.
    part, wide = np.zeros(len(rows), np.int64), order[np.repeat(~is_small, np.diff(first))]
    part[wide] = np.unique(rows[wide, :3], axis=0, return_inverse=True)[1].ravel()
    numbers = np.column_stack([numbers, part])
    order = grid.lexicographic(numbers)
    points, cells, first = grid.cells_of(rows, numbers, order)
    return order, points, cells, first, grid.cell_bounds(points, first)[0]


def _pairs(cells: Int64, bounds: Float64, edge: float) -> Pairs:
    pairs = np.empty((6 * len(cells), 2), np.int32)
    found = _find_pairs(cells, bounds, edge, pairs)
    if found > len(pairs):
        pairs = np.empty((found, 2), np.int32)
        _find_pairs(cells, bounds, edge, pairs)
    return pairs[:found]


def _find_pairs(cells: Int64, bounds: Float64, edge: float, pairs: Pairs) -> int:
    starts = grid.row_starts(cells)
    level = cells[starts[:-1], 0]
    ends = np.append(np.flatnonzero(np.diff(level, prepend=-1)), len(level))
    found = 0
    for k in range(len(ends) - 1):
        rows = starts[ends[k] : ends[k + 1] + 1]
        level_edge = edge * 2.0 ** level[ends[k]]
        reach = int(np.floor(np.sqrt(bounds[rows[0] : rows[-1], 6].max()) / level_edge + grid.ROUNDING)) + 1
        found = grid.find_in_level(cells, bounds, rows, reach, pairs, found)
        for lower in range(k):
            of_lower = starts[ends[lower]], starts[ends[lower + 1]]
            found = grid.find_in_higher(cells, bounds, of_lower, (rows[0], rows[-1]), level_edge, pairs, found)
    return found
