"""Compiled: whether a gate is clear, and whether there is room behind it."""

from typing import NamedTuple

import numpy as np

from fbench.datasets.city.traffic.occupancy_kernel import Occupancy
from fbench.datasets.city.traffic.state import HERE, WINDOW
from fbench.replay.arrays import Array, Float64
from fbench.replay.kernels import kernel

_QUEUE_MPS, _QUEUE_SHARE = 2.0, 0.2
"""Who is slower, or slower than this share of its own speed, belongs to a queue."""


class Holders(NamedTuple):
    """Who has a right on which lanes with gates, by lane."""

    first: Array
    """(L + 1,)."""
    who: Array
    rear_m: Float64
    """Its rear, counted from the lane's beginning."""


@kernel
def has_room(lanes: Array, movers: Array, way: Array, taken: Occupancy, i: int, last: int, end: float) -> bool:
    """Whether the body fits behind `end`, when all who go before it have closed up to a queue or to the next line."""
    me = movers[i]
    needed = me["length_m"] + 0.5 + me["standing_gap_m"]
    offset = 0.0
    for k in range(HERE, WINDOW):
        lane = way[i, k]
        for row in range(taken.first[lane], taken.first[lane + 1]):
            n = taken.who[row]
            at = taken.at_m[row] + offset
            if n == i or at <= me["at_m"]:
                continue
            other = movers[n]
            rear = at - 0.5 * other["length_m"]
            if rear < end and not _goes_to(way[n], way[i, last]):
                continue
            if other["speed_mps"] < min(_QUEUE_MPS, _QUEUE_SHARE * other["fastest_mps"]):
                return bool(rear - needed >= end)
            needed += other["length_m"] + other["standing_gap_m"]
        offset += lanes[lane]["length_m"]
        if k >= last and (lanes[lane]["signal"] >= 0 or offset > end + 60.0):
            return bool(offset - needed >= end)
    return True


@kernel
def _goes_to(way: Array, lane: int) -> bool:
    for k in range(HERE - 1, WINDOW):  # noqa: SIM110  # no generators in kernels
        if way[k] == lane:
            return True
    return False


@kernel
def is_clear(
    lanes: Array, gates: Array, conflicts: Array, movers: Array, way: Array, i: int, k: int, g: int, last: int,
    held: Holders, blocked: Array, blocker: Array,
) -> bool:  # fmt: skip
    """Whether nobody has, or was just given, a right to what meets the gates from `g` to those at place `last`.

    `blocked` (B,) are lanes that were just given or are kept free, and `blocker` (B,) for whom.
    """
    for m in range(k, last + 1):
        lane = lanes[way[m]]
        for gate in range(lane["gate_from"], lane["gate_to"]):
            if m == k and gate < g:
                continue
            for c in range(gates[gate]["conflict_from"], gates[gate]["conflict_to"]):
                met = conflicts[c]
                for row in range(held.first[met["lane"]], held.first[met["lane"] + 1]):
                    n, rear = held.who[row], held.rear_m[row]
                    if n != i and rear < met["to_m"] and _may_reach(movers[n], met["from_m"], rear):
                        return False
                for row in range(len(blocked)):
                    if blocked[row] == met["lane"] and blocker[row] != i:
                        return False
    return True


@kernel
def _may_reach(other: np.void, from_m: float, rear: float) -> bool:
    """Whether a mover's right goes beyond `from_m` of a lane, of which its rear is at `rear`."""
    begin = other["base_m"] + other["at_m"] - 0.5 * other["length_m"] - rear
    front = rear + other["length_m"]
    holds: bool = other["right_to_m"] > begin + from_m + 1e-6 or front > from_m
    return holds
