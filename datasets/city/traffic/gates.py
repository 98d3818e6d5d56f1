"""Stretches of lanes that one enters only with the right to them."""

import numpy as np

from fbench.datasets.city.traffic.conflicts import Conflicts
from fbench.datasets.city.world.city_map import Lane
from fbench.replay.arrays import Array, Float64

_APART_M = 2.0
"""Stretches that are nearer to each other become one."""

GATE = np.dtype([("from_m", "f8"), ("to_m", "f8"), ("conflict_from", "i8"), ("conflict_to", "i8")])
"""A stretch of a lane, and rows of what meets it."""
CONFLICT = np.dtype([("lane", "i8"), ("from_m", "f8"), ("to_m", "f8")])
"""Another lane, and where along it a body would be in the way."""
SPLIT = np.dtype([("lane", "i8"), ("until_m", "f8")])
"""A lane that begins at the same node, and how far along it a body is still in the way."""


def splits_of(conflicts: Conflicts, num_lanes: int) -> tuple[Array, Array]:
    """Return where each lane's rows begin (L + 1,), and the rows of `SPLIT`."""
    lane = conflicts.lane[conflicts.parts]
    rows = np.zeros(len(lane), SPLIT)
    rows["lane"], rows["until_m"] = conflicts.other[conflicts.parts], conflicts.other_to_m[conflicts.parts]
    return np.searchsorted(lane, np.arange(num_lanes + 1)), rows


def gates_of(lanes: tuple[Lane, ...], along: list[Float64], conflicts: Conflicts) -> tuple[Array, Array, Array]:
    """Return where each lane's gates begin (L + 1,), rows of `GATE`, and rows of `CONFLICT`.

    Whole lanes in junctions, and lanes after a signal, are one gate from their beginning; elsewhere a gate is where
    other lanes come near.
    """
    after_signal = {k for lane in lanes if lane.signal is not None for k in lane.successors}
    first: list[int] = [0]
    gates: list[tuple[float, float, int, int]] = []
    rows: list[int] = []
    for i, lane in enumerate(lanes):
        mine = np.flatnonzero((conflicts.lane == i) & ~conflicts.parts)
        whole = lane.in_junction or i in after_signal
        for begin, end, members in _merged(conflicts, mine, float(along[i][-1]), whole):
            gates.append((begin, end, len(rows), len(rows) + len(members)))
            rows += members
        first.append(len(gates))
    taken, met = np.array(rows, np.int64), np.zeros(len(rows), CONFLICT)
    met["lane"], met["from_m"] = conflicts.other[taken], conflicts.other_from_m[taken]
    met["to_m"] = conflicts.other_to_m[taken]
    return np.array(first), np.array(gates, GATE), met


def _merged(conflicts: Conflicts, mine: Array, length_m: float, whole: bool) -> list[tuple[float, float, list[int]]]:
    if whole:
        return [(0.0, length_m, [int(row) for row in mine])]
    gates: list[tuple[float, float, list[int]]] = []
    for row in mine[np.argsort(conflicts.lane_from_m[mine], kind="stable")]:
        begin, end = float(conflicts.lane_from_m[row]), float(conflicts.lane_to_m[row])
        if gates and begin < gates[-1][1] + _APART_M:
            before = gates.pop()
            gates.append((before[0], max(before[1], end), [*before[2], int(row)]))
        else:
            gates.append((begin, end, [int(row)]))
    return gates
