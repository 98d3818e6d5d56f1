"""Compiled DBSCAN over weighted cells, each with a reach of its own."""

from typing import TypeAlias

import numpy as np

from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.kernels import kernel

Reaching: TypeAlias = tuple[Int64, Float64, Float64, Float64, float, float]
"""What tells neighbours: place, xy, reach, velocity and edge as of `connected`, and the longest reach."""


@kernel
def _root(parent: Int64, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel
def _first_at_or_after(place: Int64, x: int, y: int) -> int:
    begin, end = 0, len(place)
    while begin < end:
        mid = (begin + end) // 2
        if place[mid, 0] < x or (place[mid, 0] == x and place[mid, 1] < y):
            begin = mid + 1
        else:
            end = mid
    return begin


@kernel
def _neighbours(i: int, reaching: Reaching, found: Int64) -> int:
    """Fill `found` with the cells within reach of cell `i`, itself included, and return how many there are."""
    place, xy, reach, velocity, edge, longest = reaching
    num = 0
    far = (reach[i] + longest) / 2
    steps = int(np.ceil(far / edge)) + 1
    for x in range(place[i, 0] - steps, place[i, 0] + steps + 1):
        at = _first_at_or_after(place, x, place[i, 1] - steps)
        while at < len(place) and place[at, 0] == x and place[at, 1] <= place[i, 1] + steps:
            dx, dy = xy[at, 0] - xy[i, 0], xy[at, 1] - xy[i, 1]
            gap = velocity[at] - velocity[i]
            within = (reach[i] + reach[at]) / 2
            # NaN: nothing measured it there, which fits anything
            if dx * dx + dy * dy + (0.0 if np.isnan(gap) else gap * gap) <= within * within:
                found[num] = at
                num += 1
            at += 1
    return num


@kernel
def connected(
    place: Int64, xy: Float64, weight: Float64, able: Bool, reach: Float64, velocity: Float64, edge: float
) -> tuple[Int64, Bool]:
    """Cluster cells: core are those of `able` (M,) that have at least a weight of 1 within reach; clusters are
    connected core cells.

    Takes cell numbers (M, 2) in lexicographic order, and for each cell its place (M, 2) [m], weight (M,), reach (M,)
    [m] and velocity (M,) as a length [m], NaN where unknown. Two cells are neighbours where their distance is at most
    the mean of their reaches.

    Returns cluster numbers (M,), by the first core cell, -1 for noise, and which cells are core (M,). Border cells
    belong to the lowest-numbered cluster that reaches them.
    """
    num = len(place)
    reaching = (place, xy, reach, velocity, edge, reach.max() if num else 0.0)
    found = np.empty(num, np.int64)
    core = _cores(reaching, weight, able, found)
    label = _numbered(_joined(reaching, core, found), core)
    return _with_borders(reaching, core, label, found), core


@kernel
def _cores(reaching: Reaching, weight: Float64, able: Bool, found: Int64) -> Bool:
    core = np.zeros(len(weight), np.bool_)
    for i in range(len(weight)):
        total = 0.0
        for k in range(_neighbours(i, reaching, found)):
            total += weight[found[k]]
        core[i] = able[i] and total >= 1.0 - 1e-9  # sums of shares are rounded
    return core


@kernel
def _joined(reaching: Reaching, core: Bool, found: Int64) -> Int64:
    """Lead each core cell towards the first of its cluster."""
    parent = np.arange(len(core))
    for i in range(len(core)):
        if core[i]:
            for k in range(_neighbours(i, reaching, found)):
                if core[found[k]]:
                    a, b = _root(parent, i), _root(parent, found[k])
                    parent[max(a, b)] = min(a, b)
    return parent


@kernel
def _numbered(parent: Int64, core: Bool) -> Int64:
    label, num_clusters = np.full(len(core), -1), 0
    for i in range(len(core)):
        if core[i]:
            root = _root(parent, i)
            if root == i:
                label[i] = num_clusters
                num_clusters += 1
            else:
                label[i] = label[root]
    return label


@kernel
def _with_borders(reaching: Reaching, core: Bool, label: Int64, found: Int64) -> Int64:
    result = label.copy()
    for i in range(len(core)):
        if not core[i]:
            for k in range(_neighbours(i, reaching, found)):
                other = label[found[k]]
                if core[found[k]] and (result[i] < 0 or other < result[i]):
                    result[i] = other
    return result
