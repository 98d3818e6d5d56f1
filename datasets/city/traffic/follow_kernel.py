"""Compiled: how hard everybody accelerates or brakes."""

import numpy as np

from fbench.datasets.city.traffic.gate_kernel import first_gate
from fbench.datasets.city.traffic.idm import free_acceleration, interaction, limited
from fbench.datasets.city.traffic.lights import GREEN
from fbench.datasets.city.traffic.network import ALONG, CURVE, Roads
from fbench.datasets.city.traffic.occupancy_kernel import Occupancy, leader, leader_beside, left_side
from fbench.datasets.city.traffic.path_kernel import segment
from fbench.datasets.city.traffic.state import HERE, WINDOW
from fbench.replay.arrays import Array, Float64
from fbench.replay.kernels import kernel

_LOOK_S, _LOOK_M = 6.0, 30.0
"""How far one looks ahead."""
_SLOWING_MPS2 = 1.2
_BRAKE_LIGHT_MPS2, _STANDING_MPS = 0.5, 0.1


@kernel
def far(v: float) -> float:
    """How far ahead [m] one looks for others at a speed."""
    return _LOOK_M + _LOOK_S * v


@kernel
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
    value: float = best
    return value


@kernel
def behind(movers: Array, i: int, v: float, gap: float, n: int) -> float:
    """How much less mover `i` accelerates because `n` is `gap` ahead."""
    if n < 0:
        return 0.0
    me = movers[i]
    return interaction(v, gap, v - movers[n]["speed_mps"], me["headway_s"], me["standing_gap_m"],
                       me["acceleration_mps2"], me["braking_mps2"])  # fmt: skip


@kernel
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
        less = behind(movers, i, v, gap, n)
        side = left_side(me)
        if side != 0:
            gap, n = leader_beside(roads, movers, way[i], taken, i, side, far(v))
            less = max(less, behind(movers, i, v, gap, n))
        less = max(less, before_gate(roads.lanes, gates, lights, me, way[i]))
        free = free_acceleration(v, desired_speed(roads.path, roads.lanes, me, way[i]), a, b)
        wanted = limited(min(free, a - less) if free > 0.0 and less > a else free - less)
        me["accel_mps2"] = 0.0 if v == 0.0 and wanted < 0.0 else wanted
        me["braking"] = wanted < -_BRAKE_LIGHT_MPS2 or v < _STANDING_MPS
        me["frozen"] = False
