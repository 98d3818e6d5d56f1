"""Compiled right of way: who may enter where lanes meet.

Whoever comes near a gate asks for the right to it: its signal must be green, behind it there must be room for the whole
body even when those ahead have closed up, and nobody may have the right to a stretch that meets it. Gates too near to
each other to stop between them are asked for at once. Who waits longest asks first, and after a while is waited for.
Who turns left asks after everybody else; vehicles that don't ask so early that nobody turns just before them.
"""

from typing import NamedTuple

import numpy as np

from fbench.datasets.city.traffic.network import DRIVE, HERE, WINDOW, Network, Roads
from fbench.datasets.city.traffic.occupancy_kernel import Occupancy, leader
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.geometry.kernels import kernel, kernel_part

_QUEUE_MPS, _QUEUE_SHARE = 2.0, 0.2  # Who is slower, or slower than this share of its own speed, belongs to a queue


class Holders(NamedTuple):
    """Who has a right on which lanes with gates, by lane."""

    first: Array  # (L + 1,)
    who: Array
    rear_m: Float64  # Its rear, counted from the lane's beginning


@kernel_part
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
            if rear < end and not (way[n, HERE - 1 :] == way[i, last]).any():
                continue
            if other["speed_mps"] < min(_QUEUE_MPS, _QUEUE_SHARE * other["fastest_mps"]):
                return bool(rear - needed >= end)
            needed += other["length_m"] + other["standing_gap_m"]
        offset += lanes[lane]["length_m"]
        if k >= last and (lanes[lane]["signal"] >= 0 or offset > end + 60.0):
            return bool(offset - needed >= end)
    return True


@kernel_part
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
                    other = movers[n]
                    # Its right, or its body, goes beyond where the lane meets the gate.
                    begin = other["base_m"] + other["at_m"] - 0.5 * other["length_m"] - rear
                    beyond = other["right_to_m"] > begin + met["from_m"] + 1e-6
                    if n != i and rear < met["to_m"] and (beyond or rear + other["length_m"] > met["from_m"]):
                        return False
                for row in range(len(blocked)):
                    if blocked[row] == met["lane"] and blocker[row] != i:
                        return False
    return True


RED, YELLOW, GREEN = 0, 1, 2


def lights_at(net: Network, time_s: float) -> Array:
    """What the signal at each lane's end (L,) shows; `GREEN` where there is none."""
    since, green_s = (time_s - net.groups["green_from_s"]) % net.cycle_s, net.groups["green_s"]
    shown = np.where(since < green_s, GREEN, np.where(since < green_s + net.yellow_s, YELLOW, RED))
    return np.asarray(np.append(shown, GREEN)[net.lanes["signal"]])  # -1, for none, takes the last


_ASK_MPS2, _STOP_MPS2 = 2.0, 3.0
"""One asks early enough to brake as gently as this, and stops at yellow where this is enough."""
_ASK_S = 4.0  # Vehicles that go straight on or turn right ask at least so long before
_PATIENCE_S, _LEFT_PATIENCE_S = 4.0, 7.0  # After how long one is waited for, and who turns left
_FIRST, _AT_LINE_M, _LONGEST_CHAIN = 1e6, 3.0, 8


@kernel_part
def first_gate(lanes: Array, gates: Array, me: np.void, way: Array) -> tuple[int, int, float]:
    """The next gate on a mover's way that it has no right to: place in the way, gate, distance from its front. The gate
    is -1 where there is none within its window.
    """
    offset = 0.0
    for k in range(HERE, WINDOW):
        lane = lanes[way[k]]
        for g in range(lane["gate_from"], lane["gate_to"]):
            begin = offset + gates[g]["from_m"]
            if me["base_m"] + begin >= me["right_to_m"] - 1e-6:
                return k, g, begin - me["at_m"] - 0.5 * me["length_m"]
        offset += lane["length_m"]
    return -1, -1, np.inf


@kernel
def give_rights(
    lanes: Array, gates: Array, conflicts: Array, lights: Array, movers: Array, way: Array, taken: Occupancy,
    held: Holders, asking: Array,
) -> None:  # fmt: skip
    """Give rights to those who ask, in their order, where nobody holds one that is in the way."""
    most = len(movers) * _LONGEST_CHAIN
    blocked, blocker = np.empty(most, np.int64), np.empty(most, np.int64)
    num = 0
    for i in asking:
        me = movers[i]
        k, g, _ = first_gate(lanes, gates, me, way[i])
        last, end, num_added = _chain(lanes, gates, lights, me, way[i], k, g, blocked[num:])
        blocker[num : num + num_added] = i
        free = last >= 0 and has_room(lanes, movers, way, taken, i, last, end)
        clear = free and is_clear(lanes, gates, conflicts, movers, way[i], i, k, g, last, held, blocked[:num], blocker)
        if clear:
            me["right_to_m"] = me["base_m"] + end
            me["waited_s"] = 0.0
        if clear or (free and me["waited_s"] >= _patience_s(lanes[way[i, k]])):
            num += num_added


@kernel
def take_back(lanes: Array, lights: Array, movers: Array, way: Array) -> None:
    """Take back rights where the signal of the next gate with one isn't green any more and one can stop before it."""
    for i in range(len(movers)):
        me, offset = movers[i], 0.0
        front, v = me["at_m"] + 0.5 * me["length_m"], me["speed_mps"]
        for k in range(HERE, WINDOW - 1):
            lane = lanes[way[i, k]]
            offset += lane["length_m"]
            if me["base_m"] + offset > me["right_to_m"]:
                break
            ahead = offset - front - me["margin_m"]
            can_stop = ahead > 0.0 and v * v / (2 * _STOP_MPS2) < ahead
            if lane["signal"] >= 0 and can_stop and not _may_ask(lanes, lights, way[i], k + 1, ahead):
                me["right_to_m"] = me["base_m"] + offset
                break


@kernel
def holders(lanes: Array, movers: Array, way: Array) -> Holders:
    """Find who has a right on which lanes."""
    num = len(movers)
    on, whos, rears = np.empty(num * WINDOW, np.int64), np.empty(num * WINDOW, np.int64), np.empty(num * WINDOW)
    first = np.zeros(len(lanes) + 1, np.int64)
    count = 0
    for i in range(num):
        me = movers[i]
        rear = me["at_m"] - 0.5 * me["length_m"]
        k, offset = HERE, 0.0
        while offset > rear and k > 0:
            k -= 1
            offset -= lanes[way[i, k]]["length_m"]
        while k < WINDOW and (me["base_m"] + offset < me["right_to_m"] or k <= HERE):
            lane = lanes[way[i, k]]
            if lane["gate_to"] > lane["gate_from"]:
                on[count], whos[count], rears[count] = way[i, k], i, rear - offset
                first[way[i, k] + 1] += 1
                count += 1
            offset += lane["length_m"]
            k += 1
    for row in range(len(lanes)):
        first[row + 1] += first[row]
    place = first[:-1].copy()
    who, rear_m = np.empty(count, np.int64), np.empty(count)
    for n in range(count):
        row = place[on[n]]
        who[row], rear_m[row] = whos[n], rears[n]
        place[on[n]] += 1
    return Holders(first, who, rear_m)


@kernel
def asking_movers(
    roads: Roads, gates: Array, lights: Array, movers: Array, way: Array, taken: Occupancy, step_s: float
) -> Array:
    """Those near a gate with a green signal and nobody before it who must ask first; longest waiting, then nearest."""
    found, key = np.empty(len(movers), np.int64), np.empty(len(movers))
    num = 0
    for i in range(len(movers)):
        me = movers[i]
        k, g, ahead = first_gate(roads.lanes, gates, me, way[i])
        v, lane = me["speed_mps"], roads.lanes[way[i, max(k, HERE)]]
        asks = g >= 0 and ahead <= _ask_m(lane, v)
        if not asks or (gates[g]["from_m"] <= 0.0 and k > HERE and not _may_ask(roads.lanes, lights, way[i], k, ahead)):
            me["waited_s"] = 0.0
            continue
        gap, n = leader(roads, movers, way[i], taken, i, ahead + 1.0)
        if n >= 0 and gap < ahead and not _has_right(movers[n], gap, ahead):
            me["waited_s"] = 0.0
            continue
        me["waited_s"] = me["waited_s"] + step_s if v < 0.5 else 0.0
        row, rank = num, 1000.0 * me["waited_s"] - ahead
        if me["waited_s"] < _patience_s(lane) - _PATIENCE_S:
            rank -= _FIRST
        while row > 0 and key[row - 1] < rank:
            found[row], key[row] = found[row - 1], key[row - 1]
            row -= 1
        found[row], key[row] = i, rank
        num += 1
    return found[:num]


@kernel_part
def _may_ask(lanes: Array, lights: Array, way: Array, k: int, ahead: float) -> bool:
    """Whether the signal before the lane at place `k` allows it: at yellow only to turn left, from the line."""
    now = lights[way[k - 1]]
    return bool(now == GREEN or (now == YELLOW and ahead < _AT_LINE_M and lanes[way[k]]["turns_left"] > 0))


@kernel_part
def _patience_s(lane: np.void) -> float:
    return _LEFT_PATIENCE_S if lane["turns_left"] else _PATIENCE_S


@kernel_part
def _ask_m(lane: np.void, v: float) -> float:
    """How far before a gate on a lane one asks for the right to it."""
    gently = v * v / (2 * _ASK_MPS2) + v + 3.0
    return gently if lane["kind"] != DRIVE or lane["turns_left"] else max(gently, _ASK_S * v)


@kernel_part
def _has_right(other: np.void, gap: float, ahead: float) -> bool:
    """Whether a leader, `gap` before one's front, may pass the gate that is `ahead` of this front."""
    allowed = other["right_to_m"] - other["base_m"] - other["at_m"]
    return bool(allowed > ahead - (gap + 0.5 * other["length_m"]) + 1e-3)


@kernel_part
def _chain(
    lanes: Array, gates: Array, lights: Array, me: np.void, way: Array, k: int, g: int, passed: Array
) -> tuple[int, float, int]:
    """Gates from `g` on without room to stop between: place in the way of the last, its end as seen from `HERE`, and
    how many; `passed` receives their lanes. The place is -1 where a signal isn't green or the way is too short to tell.
    """
    offset = 0.0
    for m in range(HERE, k):
        offset += lanes[way[m]]["length_m"]
    needed = me["length_m"] + 2 * me["margin_m"] + 0.3
    end, last, num = -1.0, -1, 0
    for m in range(k, WINDOW):
        lane = lanes[way[m]]
        for gate in range(lane["gate_from"], lane["gate_to"]):
            if m == k and gate < g:
                continue
            if last >= 0 and offset + gates[gate]["from_m"] - end > needed:
                return last, end, num
            if num >= len(passed):
                return -1, end, num
            passed[num] = way[m]
            num += 1
            last, end = m, offset + gates[gate]["to_m"]
        behind_it = offset + lane["length_m"] - end
        if last >= 0 and lane["signal"] >= 0 and lights[way[m]] < GREEN and behind_it < needed:
            return -1, end, num
        offset += lane["length_m"]
    return -1, end, num
