"""Compiled car following (intelligent driver model) and lane changes (MOBIL).

Treiber, Hennecke, Helbing, "Congested traffic states in empirical observations and microscopic simulations", Phys. Rev.
E 62 (2000), equations 2 to 4; above the desired speed as in the "improved" model of Treiber, Kesting, "Traffic Flow
Dynamics" (2013), section 11.3.7, where nobody brakes harder than comfortable because of a speed limit alone.

Kesting, Treiber, Helbing, "General lane-changing model MOBIL for car-following models", Transportation Research Record
1999 (2007), with the European keep-right bias of its equations 7 to 9 as a constant.
"""

import numpy as np

from fbench.datasets.city.traffic.gate_kernel import GREEN, first_gate
from fbench.datasets.city.traffic.network import ALONG, AXLE, CHANGE_S, CURVE, DRIVE, HERE, WINDOW, Roads
from fbench.datasets.city.traffic.occupancy_kernel import Occupancy, last_on, leader, leader_on_neighbor, left_side
from fbench.datasets.city.traffic.path_kernel import curve, nearest_point, neighbor, segment
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.geometry.kernels import kernel, kernel_part

HARDEST_MPS2 = 8.0  # Full braking on a dry road


@kernel
def free_acceleration(v: float, desired: float, a: float, b: float) -> float:
    """Acceleration [m/s^2] on an empty road: a (1 - (v / v0)^4) up to the desired speed, at least -b above it."""
    if v <= desired:
        ratio = v / desired
        return a * (1.0 - ratio * ratio * ratio * ratio)
    return float(-b * (1.0 - (desired / v) ** (4.0 * a / b)))


@kernel
def interaction(v: float, gap: float, closing: float, headway: float, standing: float, a: float, b: float) -> float:
    """How much less [m/s^2] because of a leader at a net gap that shrinks at `closing` [m/s]: a (s* / s)^2."""
    wanted = standing + max(0.0, v * headway + 0.5 * v * closing / np.sqrt(a * b))
    ratio = wanted / max(gap, 0.01)
    return float(a * ratio * ratio)


@kernel
def limit_braking(acceleration: float) -> float:
    """What brakes can do."""
    return max(acceleration, -HARDEST_MPS2)


_LOOK_S, _LOOK_M = 6.0, 30.0  # How far one looks ahead
_SLOWING_MPS2, _BRAKE_LIGHT_MPS2, _STANDING_MPS = 1.2, 0.5, 0.1


@kernel_part
def far(v: float) -> float:
    """How far ahead [m] one looks for others at a speed."""
    return _LOOK_M + _LOOK_S * v


@kernel_part
def desired_speed(path: Float64, lanes: Array, me: np.void, way: Array) -> float:
    """Speed [m/s] of a mover on an empty road: its own, the limit, and what curves here and ahead allow."""
    lane, s = lanes[way[HERE]], me["at_m"]
    row = segment(path, lane, s)
    share = (s - path[row, ALONG]) / (path[row + 1, ALONG] - path[row, ALONG])
    curve = path[row, CURVE] + share * (path[row + 1, CURVE] - path[row, CURVE])
    best = min(me["fastest_mps"], lane["speed_mps"] * me["factor"], curve)
    ahead = lane["length_m"] - s
    for k in range(HERE + 1, WINDOW):
        if 2 * _SLOWING_MPS2 * ahead > best * best:
            break
        lane = lanes[way[k]]
        entry = min(lane["speed_mps"] * me["factor"], path[lane["point_from"], CURVE])
        best = min(best, np.sqrt(entry * entry + 2 * _SLOWING_MPS2 * ahead))
        ahead += lane["length_m"]
    return float(best)


@kernel_part
def loss_to_leader(movers: Array, i: int, v: float, gap: float, n: int) -> float:
    """How much less mover `i` accelerates because `n` is `gap` ahead."""
    if n < 0:
        return 0.0
    me = movers[i]
    return interaction(v, gap, v - movers[n]["speed_mps"], me["headway_s"], me["standing_gap_m"],
                       me["acceleration_mps2"], me["braking_mps2"])  # fmt: skip


@kernel_part
def before_gate(lanes: Array, gates: Array, lights: Array, me: np.void, way: Array) -> float:
    """How much less because of the next gate that one may not enter yet."""
    v = me["speed_mps"]
    k, _, ahead = first_gate(lanes, gates, me, way)
    if k < 0 or ahead > v * v / 3.0 + 2.0 * v + 5.0:
        return 0.0
    is_red = k > HERE and lights[way[k - 1]] < GREEN
    if not is_red and ahead > v * v / 4.0 + v + 3.0:
        return 0.0
    return interaction(v, ahead, v, 0.4, me["margin_m"], me["acceleration_mps2"], me["braking_mps2"])


@kernel
def accelerate(roads: Roads, gates: Array, lights: Array, movers: Array, way: Array, taken: Occupancy) -> None:
    """Set everybody's acceleration and brake lights."""
    for i in range(len(movers)):
        me = movers[i]
        v = me["speed_mps"]
        a, b = me["acceleration_mps2"], me["braking_mps2"]
        gap, n = leader(roads, movers, way[i], taken, i, far(v))
        less = loss_to_leader(movers, i, v, gap, n)
        side = left_side(me)
        if side != 0:
            gap, n = leader_on_neighbor(roads, movers, way[i], taken, i, side, far(v))
            less = max(less, loss_to_leader(movers, i, v, gap, n))
        less = max(less, before_gate(roads.lanes, gates, lights, me, way[i]))
        free = free_acceleration(v, desired_speed(roads.path, roads.lanes, me, way[i]), a, b)
        wanted = limit_braking(min(free, a - less) if free > 0.0 and less > a else free - less)
        me["accel_mps2"] = 0.0 if v == 0.0 and wanted < 0.0 else wanted
        me["braking"] = wanted < -_BRAKE_LIGHT_MPS2 or v < _STANDING_MPS
        me["frozen"] = False


_EVERY = 10  # Steps between one's thoughts of a lane change
_POLITENESS, _SAFE_MPS2, _THRESHOLD_MPS2, _BIAS_MPS2 = 0.2, 2.0, 0.15, 0.25
"""Share of others' loss that counts, hardest braking of the one behind, least gain, and what the right is worth."""
_SLOWEST_MPS, _REST_S = 5.0, 2.0  # Time between changes
_APART_M = 40.0  # Two who change at the same time are so far apart


@kernel
def change_lanes(roads: Roads, gates: Array, movers: Array, way: Array, taken: Occupancy, step: int) -> int:
    """Let those change lanes who gain by it and are in nobody's way; return how many. Their ways end there."""
    path, lanes = roads.path, roads.lanes
    changed, num = np.empty(len(movers), np.int64), 0
    a, b = np.empty(9), np.empty(9)
    for i in range(len(movers)):
        if (step + i) % _EVERY or not _may_think(lanes, gates, movers[i], way[i]):
            continue
        side = _better_side(roads, movers, way[i], taken, i)
        if side == 0:
            continue
        near = False
        curve(path, lanes[way[i, HERE]], movers[i]["at_m"], a)
        for n in changed[:num]:
            curve(path, lanes[way[n, HERE]], movers[n]["at_m"], b)
            near = near or (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 < _APART_M * _APART_M
        if not near:
            _begin(path, lanes, movers[i], way[i], side)
            changed[num] = i
            num += 1
    return num


@kernel_part
def _may_think(lanes: Array, gates: Array, me: np.void, way: Array) -> bool:
    """Not while changing or slow, and not with a gate or the end of the neighbors near."""
    lane, v = lanes[way[HERE]], me["speed_mps"]
    if lane["kind"] != DRIVE or v < _SLOWEST_MPS or (lane["left"] < 0 and lane["right"] < 0):
        return False
    rear = me["base_m"] + me["at_m"] - 0.5 * me["length_m"]
    if rear < me["side_from_m"] + me["side_for_m"] + _REST_S * v:
        return False
    _, _, ahead = first_gate(lanes, gates, me, way)
    return bool(ahead > 5.0 * v + 10.0 and me["at_m"] > 0.5 * me["length_m"])


@kernel_part
def _better_side(roads: Roads, movers: Array, way: Array, taken: Occupancy, i: int) -> int:
    """1 for left, -1 for right, 0 to stay; `way` (WINDOW,) is the mover's own."""
    lanes, me = roads.lanes, movers[i]
    v = me["speed_mps"]
    gap, n = leader(roads, movers, way, taken, i, far(v))
    now = _acceleration_on(lanes[way[HERE]], me, loss_to_leader(movers, i, v, gap, n))
    best, best_gain = 0, _THRESHOLD_MPS2
    for side in (-1, 1):
        lane = neighbor(lanes[way[HERE]], side)
        if lane < 0 or me["length_m"] > lanes[lane]["longest_m"]:
            continue
        if side == 1 and me["keeps_right"] and lanes[lane]["left"] < 0:
            continue
        gap, n = leader_on_neighbor(roads, movers, way, taken, i, side, far(v))
        then = loss_to_leader(movers, i, v, gap, n)
        if gap < me["standing_gap_m"] + 0.5 * v * me["headway_s"] or then > _SAFE_MPS2:
            continue
        loss = _loss_behind(roads.path, lanes, movers, way, taken, i, side)
        gain = _acceleration_on(lanes[lane], me, then) - now - _POLITENESS * loss - side * _BIAS_MPS2
        if loss < _SAFE_MPS2 and gain > best_gain:
            best, best_gain = side, gain
    return best


@kernel_part
def _acceleration_on(lane: np.void, me: np.void, less: float) -> float:
    """Acceleration on a lane, where whoever is ahead takes `less` away."""
    allowed = min(me["fastest_mps"], lane["speed_mps"] * me["factor"])
    return free_acceleration(me["speed_mps"], allowed, me["acceleration_mps2"], me["braking_mps2"]) - less


@kernel_part
def _loss_behind(path: Float64, lanes: Array, movers: Array, way: Array, taken: Occupancy, i: int, side: int) -> float:
    """How much less the next one behind on the other lane would accelerate; infinite where there is no room."""
    me, offset = movers[i], 0.0
    for k in range(HERE, -1, -1):
        if way[k] < 0:
            return 0.0
        if k < HERE:
            offset += lanes[way[k]]["length_m"]
        lane = neighbor(lanes[way[k]], side)
        if lane < 0:
            return 0.0
        s = nearest_point(path, lanes[way[k]], lanes[lane], me["at_m"] + offset)
        row = last_on(taken, lane, s, i)
        if row >= 0:
            n = taken.who[row]
            other = movers[n]
            gap = s - taken.at_m[row] - 0.5 * (me["length_m"] + other["length_m"])
            v = other["speed_mps"]
            if gap < other["standing_gap_m"] + 0.5 * v * other["headway_s"]:
                return np.inf
            return loss_to_leader(movers, n, v, gap, i)
        if me["at_m"] + offset > far(me["speed_mps"]):
            return 0.0
    return 0.0


@kernel_part
def _begin(path: Float64, lanes: Array, me: np.void, way: Array, side: int) -> None:
    """Go on along the neighbor, beside it at first."""
    work, there = np.empty(9), np.empty(9)
    old, s = lanes[way[HERE]], me["at_m"]
    curve(path, old, s, work)
    lane = lanes[neighbor(lanes[way[HERE]], side)]
    at = nearest_point(path, old, lane, s)
    curve(path, lane, at, there)
    norm = np.sqrt(there[3] ** 2 + there[4] ** 2)
    me["side_m"] = ((work[0] - there[0]) * -there[4] + (work[1] - there[1]) * there[3]) / norm
    me["base_m"] += s - at
    me["right_to_m"] = max(me["base_m"] + at + 0.5 * me["length_m"], 0.0)
    me["at_m"] = at
    me["side_from_m"] = me["base_m"] + at + AXLE * me["length_m"]
    me["side_for_m"] = CHANGE_S * me["speed_mps"]
    for k in range(HERE + 1):
        beside_it = neighbor(lanes[way[k]], side) if way[k] >= 0 else -1
        way[k] = beside_it if beside_it >= 0 else way[k]
    for k in range(HERE + 1, WINDOW):
        way[k] = -1
