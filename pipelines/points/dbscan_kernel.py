"""Compiled loops of DBSCAN on a grid of cells with edge eps / 2, whose points are all within eps of each other."""

import numpy as np

from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.kernels import kernel

REACH = 2
"""Points within eps are at most this many cells apart."""
RUNS = (2 * REACH + 1) ** 2
"""Runs of cells along the last axis that surround one cell."""


@kernel
def _first_at_or_after(cells: Float64, x: float, y: float, z: float) -> int:
    low, high = 0, len(cells)
    while low < high:
        mid = (low + high) // 2
        a, b, c = cells[mid, 0], cells[mid, 1], cells[mid, 2]
        if a < x or (a == x and (b < y or (b == y and c < z))):
            low = mid + 1
        else:
            high = mid
    return low


@kernel
def neighbour_cells(cells: Float64) -> tuple[Int64, Int64]:
    """For each cell (M, 3), sorted lexicographically, list the cells around it and itself.

    Returns `starts` (M, RUNS) and `stops` (M, RUNS): half-open runs of rows in `cells`.
    """
    num = len(cells)
    starts = np.zeros((num, RUNS), np.int64)
    stops = np.zeros((num, RUNS), np.int64)
    for i in range(num):
        for k in range(RUNS):
            x = cells[i, 0] + k // (2 * REACH + 1) - REACH
            y, z = cells[i, 1] + k % (2 * REACH + 1) - REACH, cells[i, 2]
            if x < cells[0, 0] or x > cells[num - 1, 0]:
                continue
            at = _first_at_or_after(cells, x, y, z - REACH)
            starts[i, k] = at
            while at < num and cells[at, 0] == x and cells[at, 1] == y and cells[at, 2] <= z + REACH:
                at += 1
            stops[i, k] = at
    return starts, stops


@kernel
def _near(points: Float64, i: int, j: int, eps2: float) -> bool:
    x = points[i, 0] - points[j, 0]
    y = points[i, 1] - points[j, 1]
    z = points[i, 2] - points[j, 2]
    near: bool = x * x + y * y + z * z <= eps2
    return near


@kernel
def _count_near(points: Float64, i: int, first: Int64, starts: Int64, stops: Int64, eps2: float, enough: int) -> int:
    """Count points within eps of point `i` in runs of cells, up to `enough`."""
    count = 0
    for k in range(RUNS):
        for j in range(first[starts[k]], first[stops[k]]):
            if _near(points, i, j, eps2):
                count += 1
                if count >= enough:
                    return count
    return count


@kernel
def core_points(points: Float64, first: Int64, starts: Int64, stops: Int64, eps2: float, min_points: int) -> Bool:
    """Tell which points (N, 3), sorted by cell, have at least `min_points` within eps, themselves included.

    `first` (M + 1,) is the row of each cell's first point.
    """
    core = np.zeros(len(points), np.bool_)
    for c in range(len(first) - 1):
        around = 0
        for k in range(RUNS):
            around += first[stops[c, k]] - first[starts[c, k]]
        if around < min_points:
            continue
        if first[c + 1] - first[c] >= min_points:
            core[first[c] : first[c + 1]] = True
            continue
        for i in range(first[c], first[c + 1]):
            core[i] = _count_near(points, i, first, starts[c], stops[c], eps2, min_points) >= min_points
    return core


@kernel
def _take_near(
    points: Float64, i: int, waiting: Int64, begin: int, count: int, label: Int64, eps2: float, stack: Int64, depth: int
) -> tuple[int, int]:
    """Stack the waiting points of one cell that are near point `i`; returns how many wait on, and the depth."""
    at = begin
    while at < begin + count:
        j = waiting[at]
        if not _near(points, i, j, eps2):
            at += 1
            continue
        label[j] = label[i]
        stack[depth] = j
        depth += 1
        count -= 1
        waiting[at] = waiting[begin + count]
    return count, depth


@kernel
def _waiting_cores(core: Bool, cell: Int64, first: Int64) -> tuple[Int64, Int64]:
    waiting = np.zeros(len(core), np.int64)
    count = np.zeros(len(first) - 1, np.int64)
    for i in range(len(core)):
        if core[i]:
            waiting[first[cell[i]] + count[cell[i]]] = i
            count[cell[i]] += 1
    return waiting, count


@kernel
def grow(
    points: Float64, order: Int64, core: Bool, cell: Int64, first: Int64, starts: Int64, stops: Int64, eps2: float
) -> Int64:
    """Number the connected components of core points, seeds taken in `order`; -1 for others.

    Each cell keeps a list of core points not yet reached, from which reached ones are taken out: dense places cost
    no more than sparse ones.
    """
    label = np.full(len(points), -1)
    waiting, count = _waiting_cores(core, cell, first)
    stack = np.zeros(len(points), np.int64)
    clusters = 0
    for seed in order:
        if not core[seed] or label[seed] >= 0:
            continue
        label[seed] = clusters
        clusters += 1
        # The seed itself waits in its own cell, is near itself, and so becomes the first on the stack.
        c = cell[seed]
        count[c], depth = _take_near(points, seed, waiting, first[c], count[c], label, eps2, stack, 0)
        while depth > 0:
            depth -= 1
            i = stack[depth]
            for k in range(RUNS):
                for c in range(starts[cell[i], k], stops[cell[i], k]):
                    count[c], depth = _take_near(points, i, waiting, first[c], count[c], label, eps2, stack, depth)
    return label


@kernel
def add_border(
    points: Float64, core: Bool, label: Int64, cell: Int64, first: Int64, starts: Int64, stops: Int64, eps2: float
) -> Int64:
    """Give points that aren't core the lowest number among the core points within eps."""
    result = label.copy()
    for i in range(len(points)):
        if core[i]:
            continue
        for k in range(RUNS):
            for j in range(first[starts[cell[i], k]], first[stops[cell[i], k]]):
                if core[j] and (result[i] < 0 or label[j] < result[i]) and _near(points, i, j, eps2):
                    result[i] = label[j]
    return result
