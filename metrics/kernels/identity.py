"""Identity: which truth track goes with which estimated track, over all steps."""

import numpy as np

from fbench.metrics.kernels.assignment import assign
from fbench.replay.arrays import Float64, Int64
from fbench.replay.kernels import kernel


@kernel
def near_keys(
    truth_start: Int64, estimate_start: Int64, block_start: Int64, similarity: Float64, truth_id: Int64,
    estimate_id: Int64, floor: float,
) -> tuple[Int64, Int64]:  # fmt: skip
    """Return, for all pairs of boxes with a similarity of `floor`, truth id times (estimate ids) plus estimate id, and
    the place of the pair in `similarity`.
    """
    num = 0
    for value in similarity:
        num += value >= floor
    key, place = np.empty(num, np.int64), np.empty(num, np.int64)
    width, k = estimate_id.max() + 1, 0
    for step in range(len(truth_start) - 1):
        b = block_start[step]
        for i in range(truth_start[step], truth_start[step + 1]):
            for j in range(estimate_start[step], estimate_start[step + 1]):
                if similarity[b] >= floor:
                    key[k], place[k] = truth_id[i] * width + estimate_id[j], b
                    k += 1
                b += 1
    return key, place


@kernel
def linked(row: Int64, column: Int64) -> Int64:
    """Return the group (P,) of each pair: pairs that share a row or column, also by way of others, are in one."""
    height = row.max() + 1
    parent = np.arange(height + column.max() + 1)
    for k in range(len(row)):
        a, b = _root(parent, row[k]), _root(parent, height + column[k])
        parent[max(a, b)] = min(a, b)
    number, group, num = np.full(len(parent), -1, np.int64), np.empty(len(row), np.int64), 0
    for k in range(len(row)):
        root = _root(parent, row[k])
        if number[root] < 0:
            number[root], num = num, num + 1
        group[k] = number[root]
    return group


@kernel
def _root(parent: Int64, node: int) -> int:
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@kernel
def best_total(row: Int64, column: Int64, weight: Int64, group: Int64) -> int:
    """Return the most that one-to-one pairs of rows and columns can weigh together.

    Args:
        row: (P,) of each pair that weighs anything.
        column: (P,)
        weight: (P,) above 0.
        group: (P,) pairs of different groups have no row or column in common; ascending.
    """
    total, first = 0, 0
    row_place, column_place = np.full(row.max() + 1, -1, np.int64), np.full(column.max() + 1, -1, np.int64)
    for g in range(group[-1] + 1):
        last, n, m = first, 0, 0
        while last < len(group) and group[last] == g:
            if row_place[row[last]] < 0:
                row_place[row[last]], n = n, n + 1
            if column_place[column[last]] < 0:
                column_place[column[last]], m = m, m + 1
            last += 1
        if n == 1 or m == 1:
            total += weight[first:last].max()
        else:
            cost = np.zeros((n, m))
            for k in range(first, last):
                cost[row_place[row[k]], column_place[column[k]]] = -weight[k]
            column_of = assign(cost)
            for i in range(n):
                if column_of[i] >= 0:
                    total -= int(cost[i, column_of[i]])
        first = last
    return total
