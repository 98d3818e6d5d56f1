"""Compiled: who is where on each lane, and who is next on one's way."""

from typing import NamedTuple

import numpy as np

from fbench.datasets.city.traffic.network import ALONG, Network
from fbench.datasets.city.traffic.path_kernel import segment, sideways
from fbench.datasets.city.traffic.state import AXLE, HERE, WINDOW, State
from fbench.replay.arrays import Array, Float64
from fbench.replay.kernels import kernel

_BESIDE_M = 0.3
"""Who is less than this beside the new lane's middle has left the old one."""


class Occupancy(NamedTuple):
    """Bodies on lanes, by lane and then along it. A body is on each lane that it reaches into."""

    first: Array
    """(L + 1,)."""
    who: Array
    at_m: Float64
    """Its middle, counted from the lane's beginning; may be before it or beyond the end."""


@kernel
def beside(net: Network, lane: int, other: int, s: float) -> float:
    """Where along `other`, which runs beside `lane`, one is at `s` of it."""
    if s <= 0.0:
        return s
    if s >= net.lanes[lane]["length_m"]:
        value: float = net.lanes[other]["length_m"] + s - net.lanes[lane]["length_m"]
        return value
    i = segment(net, lane, s)
    j = net.lanes[other]["point_from"] + i - net.lanes[lane]["point_from"]
    share = (s - net.path[i, ALONG]) / (net.path[i + 1, ALONG] - net.path[i, ALONG])
    value = net.path[j, ALONG] + share * (net.path[j + 1, ALONG] - net.path[j, ALONG])
    return value  # noqa: RET504  # typed above


@kernel
def left_side(state: State, i: int) -> int:
    """On which side of its new lane a mover still is: 1 left, -1 right, 0 neither."""
    rear = state.movers[i]["base_m"] + state.movers[i]["at_m"] - AXLE * state.movers[i]["length_m"]
    rest, _ = sideways((rear - state.movers[i]["side_from_m"]) / state.movers[i]["side_for_m"])
    side = state.movers[i]["side_m"] * rest
    if side > _BESIDE_M:
        return 1
    return -1 if side < -_BESIDE_M else 0


@kernel
def neighbour(net: Network, lane: int, side: int) -> int:
    """Lane to the left (1), to the right (-1) or itself (0); -1 for none."""
    if side == 0:
        return lane
    found: int = net.lanes[lane]["left"] if side > 0 else net.lanes[lane]["right"]
    return found


@kernel
def occupancy(net: Network, state: State) -> Occupancy:
    """Find who is where."""
    num = len(state.movers)
    lanes, whos, ats = np.empty(num * 16, np.int64), np.empty(num * 16, np.int64), np.empty(num * 16)
    count = 0
    for i in range(num):
        rear, front = (
            state.movers[i]["at_m"] - 0.5 * state.movers[i]["length_m"],
            state.movers[i]["at_m"] + 0.5 * state.movers[i]["length_m"],
        )
        side = left_side(state, i)
        k, offset = HERE, 0.0
        while offset > rear and k > 0:
            k -= 1
            offset -= net.lanes[state.way[i, k]]["length_m"]
        while k < WINDOW and offset < front and count < len(lanes) - 2:
            lane = state.way[i, k]
            lanes[count], whos[count], ats[count] = lane, i, state.movers[i]["at_m"] - offset
            count += 1
            old = neighbour(net, lane, side)
            if side != 0 and old >= 0:
                lanes[count], whos[count], ats[count] = old, i, beside(net, lane, old, state.movers[i]["at_m"] - offset)
                count += 1
            offset += net.lanes[lane]["length_m"]
            k += 1
    return _sorted(len(net.lanes), lanes[:count], whos[:count], ats[:count])


@kernel
def _sorted(num_lanes: int, lanes: Array, whos: Array, ats: Float64) -> Occupancy:
    first = np.zeros(num_lanes + 1, np.int64)
    for lane in lanes:
        first[lane + 1] += 1
    for lane in range(num_lanes):
        first[lane + 1] += first[lane]
    filled = np.zeros(num_lanes, np.int64)
    who, at = np.empty(len(lanes), np.int64), np.empty(len(lanes))
    for n in range(len(lanes)):
        lane = lanes[n]
        row = first[lane] + filled[lane]
        while row > first[lane] and at[row - 1] > ats[n]:
            at[row], who[row] = at[row - 1], who[row - 1]
            row -= 1
        at[row], who[row] = ats[n], whos[n]
        filled[lane] += 1
    return Occupancy(first, who, at)


@kernel
def next_on(taken: Occupancy, lane: int, s: float, i: int) -> int:
    """Row of the first body beyond `s` on a lane other than `i`, -1 for none."""
    for row in range(taken.first[lane], taken.first[lane + 1]):
        if taken.at_m[row] > s and taken.who[row] != i:
            return row
    return -1


@kernel
def last_on(taken: Occupancy, lane: int, s: float, i: int) -> int:
    """Row of the last body up to `s` on a lane other than `i`, -1 for none."""
    for row in range(taken.first[lane + 1] - 1, taken.first[lane] - 1, -1):
        if taken.at_m[row] <= s and taken.who[row] != i:
            return row
    return -1


@kernel
def leader(net: Network, state: State, taken: Occupancy, i: int, side: int, far_m: float) -> tuple[float, int]:
    """Net gap to whoever is next on a mover's way, or on the lanes left (1) or right (-1) of it, and who; -1: none."""
    best, who, offset = np.inf, -1, 0.0
    for k in range(HERE, WINDOW):
        lane = neighbour(net, state.way[i, k], side)
        if lane < 0 or offset - state.movers[i]["at_m"] > far_m:
            break
        here = state.movers[i]["at_m"] - offset
        s = here if side == 0 else beside(net, state.way[i, k], lane, here)
        row = next_on(taken, lane, s, i)
        if row >= 0:
            n = taken.who[row]
            gap = taken.at_m[row] - s - 0.5 * (state.movers[n]["length_m"] + state.movers[i]["length_m"])
            if gap < best:
                best, who = gap, n
        if side == 0:
            gap, n = _parting(net, state, taken, i, lane, here)
            if gap < best:
                best, who = gap, n
        if row >= 0:
            break
        offset += net.lanes[state.way[i, k]]["length_m"]
    return best, who


@kernel
def _parting(net: Network, state: State, taken: Occupancy, i: int, lane: int, s: float) -> tuple[float, int]:
    """The next who has just turned off to a lane that begins where this one does."""
    best, who = np.inf, -1
    for m in range(net.lanes[lane]["split_from"], net.lanes[lane]["split_to"]):
        other = net.splits[m]["lane"]
        for row in range(taken.first[other], taken.first[other + 1]):
            n, at = taken.who[row], taken.at_m[row]
            if n != i and at > s and at - 0.5 * state.movers[n]["length_m"] < net.splits[m]["until_m"]:
                gap = at - s - 0.5 * (state.movers[n]["length_m"] + state.movers[i]["length_m"])
                if gap < best:
                    best, who = gap, n
    return best, who
