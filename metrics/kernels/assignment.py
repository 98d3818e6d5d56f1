"""Rectangular linear assignment: which pairs have the least total cost."""

import numpy as np

from fbench.replay.arrays import Float64, Int64
from fbench.replay.kernels import kernel


@kernel
def assign(cost: Float64) -> Int64:
    """Return the column (n,) of each row, -1 for rows without one, such that the costs (n, m) sum up to the least.

    min(n, m) pairs are made. Shortest augmenting paths, David F. Crouse, "On implementing 2D rectangular assignment
    algorithms", IEEE TAES 52(4), 2016. Ties are broken as scipy 1.17's `linear_sum_assignment` breaks them, on which
    the reference tools are built: rows enter in their order, the wider side is searched from its end, and free columns
    go before taken ones.
    """
    n, m = cost.shape
    column_of = np.full(n, -1, np.int64)
    if n == 0 or m == 0:
        return column_of
    if n <= m:
        _augment(cost, column_of)
        return column_of
    row_of = np.full(m, -1, np.int64)
    _augment(np.ascontiguousarray(cost.T), row_of)
    for j in range(m):
        column_of[row_of[j]] = j
    return column_of


@kernel
def _augment(cost: Float64, column_of: Int64) -> None:
    """Fill in the column (n,) of each row of costs (n, m), n <= m."""
    n, m = cost.shape
    row_price, column_price = np.zeros(n), np.zeros(m)
    row_of, parent = np.full(m, -1, np.int64), np.full(m, -1, np.int64)
    reach, rest = np.empty(m), np.empty(m, np.int64)
    for start in range(n):
        end, left = _free_column(start, cost, row_price, column_price, row_of, parent, reach, rest)
        length = reach[end]
        row_price[start] += length
        for k in range(left, m):  # columns that the search has settled
            j = rest[k]
            column_price[j] -= length - reach[j]
            if j != end:
                row_price[row_of[j]] += length - reach[j]
        row = -1
        while row != start:
            row = parent[end]
            row_of[end] = row
            column_of[row], end = end, column_of[row]


@kernel
def _free_column(
    start: int, cost: Float64, row_price: Float64, column_price: Float64, row_of: Int64, parent: Int64,
    reach: Float64, rest: Int64,
) -> tuple[int, int]:  # fmt: skip
    """Return the free column that is nearest to row `start`, and where settled columns begin in `rest` (m,).

    Fills in the row before each column on its path, `parent` (m,), and how far columns are, `reach` (m,).
    """
    m = len(rest)
    for j in range(m):
        rest[j], reach[j] = m - 1 - j, np.inf
    length, row, left = 0.0, start, m
    while True:
        best, lowest = -1, np.inf
        for k in range(left):
            j = rest[k]
            through = length + cost[row, j] - row_price[row] - column_price[j]
            if through < reach[j]:
                parent[j], reach[j] = row, through
            if reach[j] < lowest or (reach[j] == lowest and row_of[j] < 0):
                lowest, best = reach[j], k
        length, j, left = lowest, rest[best], left - 1
        rest[best], rest[left] = rest[left], j
        if row_of[j] < 0:
            return j, left
        row = row_of[j]
