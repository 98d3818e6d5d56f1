"""Compiled: lane changes after MOBIL.

Kesting, Treiber, Helbing, "General lane-changing model MOBIL for car-following models", Transportation Research Record
1999 (2007), with the European keep-right bias of its equations 7 to 9 as a constant.
"""

import numpy as np

from fbench.datasets.city.traffic.follow_kernel import behind, far
from fbench.datasets.city.traffic.gate_kernel import first_gate
from fbench.datasets.city.traffic.idm import free_acceleration
from fbench.datasets.city.traffic.network import DRIVE, Network
from fbench.datasets.city.traffic.occupancy_kernel import Occupancy, beside, last_on, leader, neighbour
from fbench.datasets.city.traffic.path_kernel import curve
from fbench.datasets.city.traffic.state import AXLE, CHANGE, CHANGE_S, HERE, NUM_CHOICES, WINDOW, State
from fbench.replay.arrays import Array
from fbench.replay.kernels import kernel

_EVERY = 10
"""Steps between one's thoughts of a lane change."""
_POLITENESS, _SAFE_MPS2, _THRESHOLD_MPS2, _BIAS_MPS2 = 0.2, 2.0, 0.15, 0.25
"""Share of others' loss that counts, hardest braking of the one behind, least gain, and what the right is worth."""
_SLOWEST_MPS = 5.0
_REST_S = 2.0
"""Time between changes."""
_APART_M = 40.0
"""Two who change at the same time are so far apart."""


@kernel
def change_lanes(net: Network, state: State, taken: Occupancy, step: int) -> None:
    """Let those change lanes who gain by it and are in nobody's way."""
    changed = np.empty(len(state.movers), np.int64)
    num = 0
    for i in range(len(state.movers)):
        if (step + i) % _EVERY or not _may_think(net, state, i):
            continue
        side = _better_side(net, state, taken, i)
        if side == 0 or _near_another(net, state, i, changed[:num]):
            continue
        _begin(net, state, i, side)
        changed[num] = i
        num += 1


@kernel
def _may_think(net: Network, state: State, i: int) -> bool:
    """Not while changing or slow, and not with a gate or the end of the neighbours near."""
    lane, v = state.way[i, HERE], state.movers[i]["speed_mps"]
    if (
        net.lanes[lane]["kind"] != DRIVE
        or v < _SLOWEST_MPS
        or (net.lanes[lane]["left"] < 0 and net.lanes[lane]["right"] < 0)
    ):
        return False
    rear = state.movers[i]["base_m"] + state.movers[i]["at_m"] - 0.5 * state.movers[i]["length_m"]
    if rear < state.movers[i]["side_from_m"] + state.movers[i]["side_for_m"] + _REST_S * v:
        return False
    _, _, ahead = first_gate(net, state, i)
    holds: bool = ahead > 5.0 * v + 10.0 and state.movers[i]["at_m"] > 0.5 * state.movers[i]["length_m"]
    return holds


@kernel
def _better_side(net: Network, state: State, taken: Occupancy, i: int) -> int:
    """1 for left, -1 for right, 0 to stay."""
    v = state.movers[i]["speed_mps"]
    gap, n = leader(net, state, taken, i, 0, far(v))
    now = _wanted(net, state, i, 0, behind(state, i, v, gap, n))
    best, best_gain = 0, _THRESHOLD_MPS2
    for side in (-1, 1):
        lane = neighbour(net, state.way[i, HERE], side)
        if lane < 0 or state.movers[i]["length_m"] > net.lanes[lane]["longest_m"]:
            continue
        if side == 1 and state.movers[i]["keeps_right"] and net.lanes[lane]["left"] < 0:
            continue
        gap, n = leader(net, state, taken, i, side, far(v))
        then = behind(state, i, v, gap, n)
        if gap < state.movers[i]["standing_gap_m"] + 0.5 * v * state.movers[i]["headway_s"] or then > _SAFE_MPS2:
            continue
        loss = _loss_behind(net, state, taken, i, side)
        gain = _wanted(net, state, i, side, then) - now - _POLITENESS * loss - side * _BIAS_MPS2
        if loss < _SAFE_MPS2 and gain > best_gain:
            best, best_gain = side, gain
    return best


@kernel
def _wanted(net: Network, state: State, i: int, side: int, less: float) -> float:
    """Acceleration on the lane beside (0: on this one), where whoever is ahead takes `less` away."""
    lane, v = neighbour(net, state.way[i, HERE], side), state.movers[i]["speed_mps"]
    allowed = min(state.movers[i]["fastest_mps"], net.lanes[lane]["speed_mps"] * state.movers[i]["factor"])
    return free_acceleration(v, allowed, state.movers[i]["acceleration_mps2"], state.movers[i]["braking_mps2"]) - less


@kernel
def _loss_behind(net: Network, state: State, taken: Occupancy, i: int, side: int) -> float:
    """How much less the next one behind on the other lane would accelerate; infinite where there is no room."""
    offset = 0.0
    for k in range(HERE, -1, -1):
        if k < HERE:
            offset += net.lanes[state.way[i, k]]["length_m"]
        lane = neighbour(net, state.way[i, k], side)
        if lane < 0:
            return 0.0
        s = beside(net, state.way[i, k], lane, state.movers[i]["at_m"] + offset)
        row = last_on(taken, lane, s, i)
        if row >= 0:
            n = taken.who[row]
            gap = s - taken.at_m[row] - 0.5 * (state.movers[i]["length_m"] + state.movers[n]["length_m"])
            v = state.movers[n]["speed_mps"]
            if gap < state.movers[n]["standing_gap_m"] + 0.5 * v * state.movers[n]["headway_s"]:
                return np.inf
            return behind(state, n, v, gap, i)
        if state.movers[i]["at_m"] + offset > far(state.movers[i]["speed_mps"]):
            return 0.0
    return 0.0


@kernel
def _near_another(net: Network, state: State, i: int, changed: Array) -> bool:
    a, b = np.empty(9), np.empty(9)
    curve(net, state.way[i, HERE], state.movers[i]["at_m"], a)
    for n in changed:
        curve(net, state.way[n, HERE], state.movers[n]["at_m"], b)
        if (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 < _APART_M * _APART_M:
            return True
    return False


@kernel
def _begin(net: Network, state: State, i: int, side: int) -> None:
    """Go on along the neighbour, beside it at first."""
    work, there = np.empty(9), np.empty(9)
    old, s = state.way[i, HERE], state.movers[i]["at_m"]
    curve(net, old, s, work)
    lane = neighbour(net, old, side)
    at = beside(net, old, lane, s)
    curve(net, lane, at, there)
    norm = np.sqrt(there[3] ** 2 + there[4] ** 2)
    aside = ((work[0] - there[0]) * -there[4] + (work[1] - there[1]) * there[3]) / norm
    state.movers[i]["base_m"] += s - at
    state.movers[i]["right_to_m"] = max(state.movers[i]["base_m"] + at + 0.5 * state.movers[i]["length_m"], 0.0)
    state.movers[i]["at_m"] = at
    state.movers[i]["side_m"] = aside
    state.movers[i]["side_from_m"] = state.movers[i]["base_m"] + at + AXLE * state.movers[i]["length_m"]
    state.movers[i]["side_for_m"] = CHANGE_S * state.movers[i]["speed_mps"]
    for k in range(HERE + 1):
        beside_it = neighbour(net, state.way[i, k], side)
        state.way[i, k] = beside_it if beside_it >= 0 else state.way[i, k]
    for k in range(HERE + 1, WINDOW):
        state.way[i, k] = -1
    extend(net, state, i)
    state.counters[CHANGE] += 1


@kernel
def extend(net: Network, state: State, i: int) -> None:
    """Choose lanes for the places of a way that are -1, each after the one before."""
    for k in range(1, WINDOW):
        if state.way[i, k] < 0:
            drawn = state.choices[i, state.movers[i]["num_chosen"] % NUM_CHOICES]
            state.movers[i]["num_chosen"] += 1
            state.way[i, k] = chosen(net, state.way[i, k - 1], state.movers[i]["length_m"], drawn)


@kernel
def chosen(net: Network, lane: int, length_m: float, drawn: float) -> int:
    """Choose a successor that bodies of this length may use."""
    first, last = net.lanes[lane]["next_from"], net.lanes[lane]["next_to"]
    total = 0.0
    for n in range(first, last):
        if net.lanes[net.nexts[n]["lane"]]["longest_m"] >= length_m:
            total += net.nexts[n]["weight"]
    if total == 0.0:
        found: int = net.nexts[first + int(drawn * (last - first))]["lane"]
        return found
    left = drawn * total
    for n in range(first, last):
        if net.lanes[net.nexts[n]["lane"]]["longest_m"] >= length_m:
            left -= net.nexts[n]["weight"]
            found = net.nexts[n]["lane"]
            if left < 0.0:
                return found
    return found
