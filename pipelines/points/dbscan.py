"""DBSCAN whose result doesn't depend on the order of the points."""

import numpy as np

from fbench.pipelines.points.dbscan_kernel import add_border, core_points, grow, neighbour_cells
from fbench.replay.arrays import Array, Int64
from fbench.replay.errors import ConfigError


def dbscan(points: Array, eps: float, min_points: int) -> Int64:
    """Cluster points (N, 1 to 3); returns cluster numbers (N,), -1 for noise.

    As defined by Ester et al., KDD 1996: a point is core when at least `min_points` points, itself included, lie
    within `eps` (closed ball); clusters are the connected components of core points. Clusters are numbered by their
    lexicographically smallest core point, and a border point belongs to the lowest-numbered cluster that reaches it.
    Radii that vary with place are had by scaling the coordinates before.

    Raises:
        ConfigError: where `eps` isn't positive or `min_points` is below 1.
    """
    if not eps > 0 or min_points < 1:
        raise ConfigError(f"dbscan: expected eps > 0 and min_points >= 1, got {eps} and {min_points}")
    if not len(points):
        return np.zeros(0, np.int64)
    given = np.asarray(points, np.float64)
    padded = np.zeros((len(given), 3))
    padded[:, 3 - given.shape[1] :] = given
    # A hair wider than eps / 2, so that rounding never puts two neighbours three cells apart.
    # Clipped to where neighbouring cells are still different numbers.
    cells = np.clip(np.floor(padded / (eps / 2 * (1 + 1e-9))), -(2.0**52), 2.0**52)
    by_cell = np.lexsort((*padded.T[::-1], *cells.T[::-1]))
    p, sorted_cells = padded[by_cell], cells[by_cell]
    fresh = np.any(np.diff(sorted_cells, axis=0, prepend=np.nan) != 0, axis=1)
    cell = np.cumsum(fresh) - 1
    first = np.append(np.flatnonzero(fresh), len(p))
    starts, stops = neighbour_cells(sorted_cells[fresh])
    core = core_points(p, first, starts, stops, eps * eps, min_points)
    label = grow(p, np.lexsort(p.T[::-1]), core, cell, first, starts, stops, eps * eps)
    result = np.empty(len(p), np.int64)
    result[by_cell] = add_border(p, core, label, cell, first, starts, stops, eps * eps)
    return result
