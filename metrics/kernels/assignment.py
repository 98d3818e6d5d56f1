"""Rectangular linear assignment: which pairs have the least total cost."""

import numpy as np

from fbench.replay.arrays import Float64, Int64
from fbench.replay.kernels import kernel


@kernel
def assign(cost: Float64, without: float) -> Int64:  # noqa: C901  # apart it compiles twice as long
    """Return the column (n,) of each row, -1 for rows without one, such that the costs (n, m) sum up to the least.

    min(n, m) pairs are made. Those with an infinite cost count as `without`, and are then taken apart again.
    Where no row and no column has two finite costs, these are the pairs, whatever they cost.

    Shortest augmenting paths, David F. Crouse, "On implementing 2D rectangular assignment algorithms", IEEE TAES
    52(4), 2016. Ties are broken as scipy 1.17's `linear_sum_assignment` breaks them, on which the reference tools are
    built: rows enter in their order, the wider side is searched from its end, and free columns go before taken ones.
    """
    n, m = cost.shape
    height, width = (n, m) if n <= m else (m, n)
    column_of, row_of, is_lonely = np.empty(n, np.int64), np.empty(width, np.int64), True
    wide = np.empty((height, width))  # no higher than wide
    for j in range(width):
        row_of[j] = -1
    for i in range(n):
        own = -1
        for j in range(m):
            value = cost[i, j]
            if value < np.inf:
                is_lonely = is_lonely and own < 0 and row_of[j] < 0
                own, row_of[j] = j, i
            else:
                value = without
            if n <= m:
                wide[i, j] = value
            else:
                wide[j, i] = value
        column_of[i] = own
    if is_lonely:
        return column_of

    row_price, partner = np.empty(height), np.empty(height, np.int64)
    column_price, reach = np.empty(width), np.empty(width)
    parent, rest = np.empty(width, np.int64), np.empty(width, np.int64)
    for i in range(height):
        row_price[i], partner[i] = 0.0, -1
    for j in range(width):
        column_price[j], row_of[j] = 0.0, -1
    for start in range(height):
        for j in range(width):
            rest[j], reach[j] = width - 1 - j, np.inf
        length, row, left, end = 0.0, start, width, -1
        while row >= 0:  # until the nearest free column; settled ones are moved to the end of `rest`
            best, lowest, price = -1, np.inf, row_price[row]
            for k in range(left):
                j = rest[k]
                far, through = reach[j], length + wide[row, j] - price - column_price[j]
                if through < far:
                    parent[j], reach[j], far = row, through, through
                if far < lowest or (far == lowest and row_of[j] < 0):
                    lowest, best = far, k
            end, length, left = rest[best], lowest, left - 1
            rest[best], rest[left] = rest[left], end
            row = row_of[end]
        row_price[start] += length
        for k in range(left, width):
            j = rest[k]
            rise = length - reach[j]
            column_price[j] -= rise
            if j != end:
                row_price[row_of[j]] += rise
        while row != start:
            row = parent[end]
            j = end
            end = partner[row]
            row_of[j], partner[row] = row, j

    for i in range(n):
        j = partner[i] if n <= m else row_of[i]
        column_of[i] = j if j >= 0 and cost[i, j] < np.inf else -1
    return column_of
