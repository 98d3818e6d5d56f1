"""Compiled: whether a gate is clear, and whether there is room behind it."""

from fbench.datasets.city.traffic.network import Network
from fbench.datasets.city.traffic.occupancy_kernel import Occupancy
from fbench.datasets.city.traffic.state import HERE, WINDOW, State
from fbench.replay.arrays import Array, Float64
from fbench.replay.kernels import kernel

_QUEUE_MPS, _QUEUE_SHARE = 2.0, 0.2
"""Who is slower, or slower than this share of its own speed, belongs to a queue."""


@kernel
def has_room(net: Network, state: State, taken: Occupancy, i: int, last: int, end: float) -> bool:
    """Whether the body fits behind `end`, when all who go before it have closed up to a queue or to the next line."""
    gap = state.movers[i]["standing_gap_m"]
    needed = state.movers[i]["length_m"] + 0.5 + gap
    offset = 0.0
    for k in range(HERE, WINDOW):
        lane = state.way[i, k]
        for row in range(taken.first[lane], taken.first[lane + 1]):
            n = taken.who[row]
            at = taken.at_m[row] + offset
            if n == i or at <= state.movers[i]["at_m"]:
                continue
            rear = at - 0.5 * state.movers[n]["length_m"]
            if rear < end and not _goes_to(state, n, state.way[i, last]):
                continue
            if state.movers[n]["speed_mps"] < min(_QUEUE_MPS, _QUEUE_SHARE * state.movers[n]["fastest_mps"]):
                return bool(rear - needed >= end)
            needed += state.movers[n]["length_m"] + state.movers[n]["standing_gap_m"]
        offset += net.lanes[lane]["length_m"]
        if k >= last and (net.lanes[lane]["signal"] >= 0 or offset > end + 60.0):
            return bool(offset - needed >= end)
    return True


@kernel
def _goes_to(state: State, n: int, lane: int) -> bool:
    for k in range(HERE - 1, WINDOW):  # noqa: SIM110  # no generators in kernels
        if state.way[n, k] == lane:
            return True
    return False


@kernel
def is_clear(
    net: Network, state: State, i: int, k: int, g: int, last: int,
    first: Array, who: Array, behind: Float64, lanes: Array, whos: Array, num: int,
) -> bool:  # fmt: skip
    """Whether nobody has, or was just given, a right to what meets the gates from `g` to those of lane `last`."""
    for m in range(k, last + 1):
        lane = state.way[i, m]
        for gate in range(net.lanes[lane]["gate_from"], net.lanes[lane]["gate_to"]):
            if m == k and gate < g:
                continue
            for c in range(net.gates[gate]["conflict_from"], net.gates[gate]["conflict_to"]):
                other = net.conflicts[c]["lane"]
                for row in range(first[other], first[other + 1]):
                    n = who[row]
                    if (
                        n != i
                        and behind[row] < net.conflicts[c]["to_m"]
                        and _may_reach(state, n, net.conflicts[c]["from_m"], behind[row])
                    ):
                        return False
                for row in range(num):
                    if lanes[row] == other and whos[row] != i:
                        return False
    return True


@kernel
def _may_reach(state: State, n: int, from_m: float, rear: float) -> bool:
    """Whether a mover's right goes beyond `from_m` of a lane, of which its rear is at `rear`."""
    begin = state.movers[n]["base_m"] + state.movers[n]["at_m"] - 0.5 * state.movers[n]["length_m"] - rear
    front = rear + state.movers[n]["length_m"]
    holds: bool = state.movers[n]["right_to_m"] > begin + from_m + 1e-6 or front > from_m
    return holds
