"""Compiled: who may enter where lanes meet.

Whoever comes near a gate asks for the right to it: its signal must be green, behind it there must be room for the whole
body even when those ahead have closed up, and nobody may have the right to a stretch that meets it. Gates too near to
each other to stop between them are asked for at once. Who waits longest asks first, and after a while is waited for.
Who turns left asks after everybody else; vehicles that don't ask so early that nobody turns just before them.
"""

import numpy as np

from fbench.datasets.city.traffic.network import DRIVE, Network
from fbench.datasets.city.traffic.occupancy_kernel import Occupancy, leader
from fbench.datasets.city.traffic.room_kernel import has_room, is_clear
from fbench.datasets.city.traffic.state import HERE, WINDOW, State
from fbench.replay.arrays import Array, Float64
from fbench.replay.kernels import kernel

_ASK_MPS2, _STOP_MPS2 = 2.0, 3.0
"""One asks early enough to brake as gently as this, and stops at yellow where this is enough."""
_ASK_S = 4.0
"""Vehicles that go straight on or turn right ask at least so long before."""
_PATIENCE_S, _LEFT_PATIENCE_S = 4.0, 7.0
"""After how long one is waited for, and who turns left."""
_FIRST = 1e6
_AT_LINE_M = 3.0
_LONGEST_CHAIN = 8


@kernel
def first_gate(net: Network, state: State, i: int) -> tuple[int, int, float]:
    """The next gate on a mover's way that it has no right to: place in the way, gate, distance from its front.

    The gate is -1 where there is none within its window.
    """
    offset = 0.0
    for k in range(HERE, WINDOW):
        lane = state.way[i, k]
        for g in range(net.lanes[lane]["gate_from"], net.lanes[lane]["gate_to"]):
            begin = offset + net.gates[g]["from_m"]
            if state.movers[i]["base_m"] + begin >= state.movers[i]["right_to_m"] - 1e-6:
                return k, g, begin - state.movers[i]["at_m"] - 0.5 * state.movers[i]["length_m"]
        offset += net.lanes[lane]["length_m"]
    return -1, -1, np.inf


@kernel
def shows(net: Network, lane: int, time_s: float) -> int:
    """What the signal at a lane's end shows: 2 green (or there is none), 1 yellow, 0 red."""
    group = net.lanes[lane]["signal"]
    if group < 0:
        return 2
    since = (time_s - net.groups[group]["green_from_s"]) % net.cycle_s
    if since < net.groups[group]["green_s"]:
        return 2
    return 1 if since < net.groups[group]["green_s"] + net.yellow_s else 0


@kernel
def give_rights(net: Network, state: State, taken: Occupancy, time_s: float, step_s: float) -> None:
    """Take back rights where the signal has changed and one can still stop; then give those that are asked for."""
    for i in range(len(state.movers)):
        _take_back(net, state, i, time_s)
    first, who, behind = _holders(net, state)
    blocked, blocker = (
        np.empty(len(state.movers) * _LONGEST_CHAIN, np.int64),
        np.empty(len(state.movers) * _LONGEST_CHAIN, np.int64),
    )
    num = 0
    for i in _asking(net, state, taken, time_s, step_s):
        k, g, _ = first_gate(net, state, i)
        num_before = num
        last, end, num = _chain(net, state, i, k, g, blocked, blocker, num, time_s)
        free = last >= 0 and has_room(net, state, taken, i, last, end)
        clear = free and is_clear(net, state, i, k, g, last, first, who, behind, blocked, blocker, num_before)
        if clear:
            state.movers[i]["right_to_m"] = state.movers[i]["base_m"] + end
            state.movers[i]["waited_s"] = 0.0
        elif not free or state.movers[i]["waited_s"] < _patience_s(net, state.way[i, k]):
            num = num_before


@kernel
def _take_back(net: Network, state: State, i: int, time_s: float) -> None:
    """Where the signal of the next gate with a right isn't green any more and one can stop before it."""
    offset = 0.0
    front = state.movers[i]["at_m"] + 0.5 * state.movers[i]["length_m"]
    for k in range(HERE, WINDOW - 1):
        lane = state.way[i, k]
        offset += net.lanes[lane]["length_m"]
        if state.movers[i]["base_m"] + offset > state.movers[i]["right_to_m"]:
            return
        ahead = offset - front - state.movers[i]["margin_m"]
        if net.lanes[lane]["signal"] >= 0 and ahead > 0.0 and not _may_ask(net, state, i, k + 1, ahead, time_s):
            v = state.movers[i]["speed_mps"]
            if v * v / (2 * _STOP_MPS2) < ahead:
                state.movers[i]["right_to_m"] = state.movers[i]["base_m"] + offset
                return


@kernel
def _holders(net: Network, state: State) -> tuple[Array, Array, Float64]:
    """By lane: where its rows begin (L + 1,), who has a right on it, and how far along it this one's rear is."""
    num = len(state.movers)
    lanes, whos, rears = np.empty(num * WINDOW, np.int64), np.empty(num * WINDOW, np.int64), np.empty(num * WINDOW)
    first = np.zeros(len(net.lanes) + 1, np.int64)
    count = 0
    for i in range(num):
        rear = state.movers[i]["at_m"] - 0.5 * state.movers[i]["length_m"]
        k, offset = HERE, 0.0
        while offset > rear and k > 0:
            k -= 1
            offset -= net.lanes[state.way[i, k]]["length_m"]
        while k < WINDOW and (state.movers[i]["base_m"] + offset < state.movers[i]["right_to_m"] or k <= HERE):
            lane = state.way[i, k]
            if net.lanes[lane]["gate_to"] > net.lanes[lane]["gate_from"]:
                lanes[count], whos[count], rears[count] = lane, i, rear - offset
                first[lane + 1] += 1
                count += 1
            offset += net.lanes[lane]["length_m"]
            k += 1
    for lane in range(len(first) - 1):
        first[lane + 1] += first[lane]
    place = first[:-1].copy()
    who, behind = np.empty(count, np.int64), np.empty(count)
    for n in range(count):
        row = place[lanes[n]]
        who[row], behind[row] = whos[n], rears[n]
        place[lanes[n]] += 1
    return first, who, behind


@kernel
def _asking(net: Network, state: State, taken: Occupancy, time_s: float, step_s: float) -> Array:
    """Those near a gate with a green signal and nobody before it who must ask first; longest waiting, then nearest."""
    found, key = np.empty(len(state.movers), np.int64), np.empty(len(state.movers))
    num = 0
    for i in range(len(state.movers)):
        k, g, ahead = first_gate(net, state, i)
        v = state.movers[i]["speed_mps"]
        if g < 0 or ahead > _ask_m(net, state.way[i, k], v):
            state.movers[i]["waited_s"] = 0.0
            continue
        if net.gates[g]["from_m"] <= 0.0 and k > HERE and not _may_ask(net, state, i, k, ahead, time_s):
            state.movers[i]["waited_s"] = 0.0
            continue
        gap, n = leader(net, state, taken, i, 0, ahead + 1.0)
        if n >= 0 and gap < ahead and not _has_right(state, n, gap, ahead):
            state.movers[i]["waited_s"] = 0.0
            continue
        state.movers[i]["waited_s"] = state.movers[i]["waited_s"] + step_s if v < 0.5 else 0.0
        row, rank = num, 1000.0 * state.movers[i]["waited_s"] - ahead
        if state.movers[i]["waited_s"] < _patience_s(net, state.way[i, k]) - _PATIENCE_S:
            rank -= _FIRST
        while row > 0 and key[row - 1] < rank:
            found[row], key[row] = found[row - 1], key[row - 1]
            row -= 1
        found[row], key[row] = i, rank
        num += 1
    return found[:num]


@kernel
def _may_ask(net: Network, state: State, i: int, k: int, ahead: float, time_s: float) -> bool:
    """Whether the signal before the lane at place `k` allows it: at yellow only to turn left, from the line."""
    now = shows(net, state.way[i, k - 1], time_s)
    holds: bool = now == 2 or (now == 1 and ahead < _AT_LINE_M and net.lanes[state.way[i, k]]["turns_left"] > 0)
    return holds


@kernel
def _patience_s(net: Network, lane: int) -> float:
    return _LEFT_PATIENCE_S if net.lanes[lane]["turns_left"] else _PATIENCE_S


@kernel
def _ask_m(net: Network, lane: int, v: float) -> float:
    """How far before a gate on a lane one asks for the right to it."""
    gently = v * v / (2 * _ASK_MPS2) + v + 3.0
    if net.lanes[lane]["kind"] != DRIVE or net.lanes[lane]["turns_left"]:
        return gently
    return max(gently, _ASK_S * v)


@kernel
def _has_right(state: State, n: int, gap: float, ahead: float) -> bool:
    """Whether the leader `n`, `gap` before one's front, may pass the gate that is `ahead` of this front."""
    middle = gap + 0.5 * state.movers[n]["length_m"]
    allowed = state.movers[n]["right_to_m"] - state.movers[n]["base_m"] - state.movers[n]["at_m"]
    holds: bool = allowed > ahead - middle + 1e-3
    return holds


@kernel
def _chain(
    net: Network, state: State, i: int, k: int, g: int, lanes: Array, whos: Array, num: int, time_s: float
) -> tuple[int, float, int]:
    """Gates from `g` on without room to stop between: place in the way of the last, its end as seen from `HERE`.

    Their lanes are added to a list. The place is -1 where a signal isn't green or the way is too short to tell.
    """
    offset = 0.0
    for m in range(HERE, k):
        offset += net.lanes[state.way[i, m]]["length_m"]
    end, last = -1.0, -1
    for m in range(k, WINDOW):
        lane = state.way[i, m]
        for gate in range(net.lanes[lane]["gate_from"], net.lanes[lane]["gate_to"]):
            if m == k and gate < g:
                continue
            if (
                last >= 0
                and offset + net.gates[gate]["from_m"] - end
                > state.movers[i]["length_m"] + 2 * state.movers[i]["margin_m"] + 0.3
            ):
                return last, end, num
            if num >= len(lanes):
                return -1, end, num
            lanes[num], whos[num] = lane, i
            num += 1
            last, end = m, offset + net.gates[gate]["to_m"]
        behind_it = offset + net.lanes[lane]["length_m"] - end
        needed = state.movers[i]["length_m"] + 2 * state.movers[i]["margin_m"] + 0.3
        if last >= 0 and net.lanes[lane]["signal"] >= 0 and shows(net, lane, time_s) < 2 and behind_it < needed:
            return -1, end, num
        offset += net.lanes[lane]["length_m"]
    return -1, end, num
