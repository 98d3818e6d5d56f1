"""Identity: which tracks have to do with each other."""

import numpy as np

from fbench.replay.arrays import Int64
from fbench.replay.kernels import kernel


@kernel
def linked(row: Int64, column: Int64, parent: Int64) -> Int64:
    """Return the group (P,) of each pair, from 0: pairs that share a row or column, also by way of others, are in one.

    Args:
        row: (P,)
        column: (P,) numbered on from the rows.
        parent: (rows and columns,) each its own, for own use.
    """
    for k in range(len(row)):
        a, b = row[k], column[k]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        if a < b:
            parent[b] = a
        else:
            parent[a] = b
    group, num = np.empty(len(row), np.int64), 0
    for node in range(len(parent)):  # a parent comes before its children
        if parent[node] == node:
            parent[node] = -1 - num
            num += 1
        else:
            parent[node] = parent[parent[node]]
    for k in range(len(row)):
        group[k] = -1 - parent[row[k]]
    return group
