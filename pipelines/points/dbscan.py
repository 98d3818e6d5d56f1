"""DBSCAN whose result doesn't depend on the order of the points."""

import numpy as np

from fbench.pipelines.points.dbscan_kernel import cluster_cells, core_points, labels
from fbench.pipelines.points.grid_kernel import Pairs, cell_bounds, cell_numbers, cells_of, lexicographic, row_starts
from fbench.pipelines.points.touching_kernel import ROUNDING, find_in_higher, find_in_level
from fbench.replay.arrays import Array, Float64, Int64
from fbench.replay.errors import ConfigError

_SHRUNK = 1 - 1e-9
"""Cells are a hair smaller than need be, so that rounding hardly ever makes their points more than a radius apart."""
_LEAST_EPS, _MOST_EPS = 1e-150, 1e150
"""Radii are clipped here, where squares still are numbers."""


def dbscan(points: Array, eps: float | Float64, min_points: int) -> Int64:
    """Cluster points (N, 1 to 3); returns cluster numbers (N,), -1 for noise.

    As defined by Ester et al., KDD 1996: a point is core when at least `min_points` points, itself included, lie
    within `eps` (closed ball); clusters are the connected components of core points. Clusters are numbered by their
    lexicographically smallest core point, and a border point belongs to the lowest-numbered cluster that reaches it.
    With a radius for each point, `eps` (N,), two points are neighbours where their distance is at most the smaller
    of their radii. Points that aren't finite are noise.

    The grid is that of Gunawan, 2013, and de Berg et al., ISAAC 2017: in cells with a diagonal of `eps` at least
    `min_points` points are core without being looked at, and clusters are joined cell by cell. Radii that vary by
    more than a factor of two have a grid for each doubling.

    Raises:
        ConfigError: where an `eps` isn't positive or `min_points` is below 1.
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
    order, points, cells, first, bounds = _grid(rows, cell_numbers(rows, level, edge))
    pairs = _pairs(cells, bounds, edge)
    core = core_points(points, first, pairs, min_points)
    root, smallest = cluster_cells(points, core, first, bounds, pairs)
    result = np.empty(num, np.int64)
    result[order] = labels(points, core, first, _numbers(points, root, smallest), pairs)
    return result


def _grid(rows: Float64, numbers: Int64) -> tuple[Int64, Float64, Int64, Int64, Float64]:
    """Sort points (N, 4) by cell; returns their order (N,), themselves, and cells, their first points and bounds."""
    order = lexicographic(numbers)
    points, cells, first = cells_of(rows, numbers, order)
    bounds, is_small = cell_bounds(points, first)
    if is_small.all():
        return order, points, cells, first, bounds
    # Far out, where a cell is no wider than rounding, only equal points are sure to be neighbours.
    part, wide = np.zeros(len(rows), np.int64), order[np.repeat(~is_small, np.diff(first))]
    part[wide] = np.unique(rows[wide, :3], axis=0, return_inverse=True)[1].ravel()
    numbers = np.column_stack([numbers, part])
    order = lexicographic(numbers)
    points, cells, first = cells_of(rows, numbers, order)
    return order, points, cells, first, cell_bounds(points, first)[0]


def _pairs(cells: Int64, bounds: Float64, edge: float) -> Pairs:
    """Pairs of cells (P, 2) that may hold neighbours."""
    pairs = np.empty((6 * len(cells), 2), np.int32)
    found = _find_pairs(cells, bounds, edge, pairs)
    if found > len(pairs):
        pairs = np.empty((found, 2), np.int32)
        _find_pairs(cells, bounds, edge, pairs)
    return pairs[:found]


def _find_pairs(cells: Int64, bounds: Float64, edge: float, pairs: Pairs) -> int:
    starts = row_starts(cells)
    level = cells[starts[:-1], 0]
    ends = np.append(np.flatnonzero(np.diff(level, prepend=-1)), len(level))
    found = 0
    for k in range(len(ends) - 1):
        rows = starts[ends[k] : ends[k + 1] + 1]
        level_edge = edge * 2.0 ** level[ends[k]]
        reach = int(np.floor(np.sqrt(bounds[rows[0] : rows[-1], 6].max()) / level_edge + ROUNDING)) + 1
        found = find_in_level(cells, bounds, rows, reach, pairs, found)
        for lower in range(k):
            of_lower = starts[ends[lower]], starts[ends[lower + 1]]
            found = find_in_higher(cells, bounds, of_lower, (rows[0], rows[-1]), level_edge, pairs, found)
    return found


def _numbers(points: Float64, root: Int64, smallest: Int64) -> Int64:
    """Number the clusters of cells (M,) by their smallest core point."""
    roots = np.flatnonzero(smallest >= 0)
    number = np.full(len(root) + 1, -1)  # the last for cells without a cluster, whose root is -1
    number[roots[np.lexsort(points[smallest[roots], 2::-1].T)]] = np.arange(len(roots))
    return number[root]
