"""Compiled: how hard everybody accelerates or brakes."""

import numpy as np

from fbench.datasets.city.traffic.gate_kernel import first_gate, shows
from fbench.datasets.city.traffic.idm import free_acceleration, interaction, limited
from fbench.datasets.city.traffic.network import ALONG, CURVE, Network
from fbench.datasets.city.traffic.occupancy_kernel import Occupancy, leader, left_side
from fbench.datasets.city.traffic.path_kernel import segment
from fbench.datasets.city.traffic.state import HERE, WINDOW, State
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
def desired_speed(net: Network, state: State, i: int) -> float:
    """Speed [m/s] of a mover on an empty road: its own, the limit, and what curves here and ahead allow."""
    lane, s = state.way[i, HERE], state.movers[i]["at_m"]
    row = segment(net, lane, s)
    share = (s - net.path[row, ALONG]) / (net.path[row + 1, ALONG] - net.path[row, ALONG])
    curve = net.path[row, CURVE] + share * (net.path[row + 1, CURVE] - net.path[row, CURVE])
    best = min(state.movers[i]["fastest_mps"], net.lanes[lane]["speed_mps"] * state.movers[i]["factor"], curve)
    ahead = net.lanes[lane]["length_m"] - s
    for k in range(HERE + 1, WINDOW):
        if 2 * _SLOWING_MPS2 * ahead > best * best:
            break
        lane = state.way[i, k]
        entry = min(
            net.lanes[lane]["speed_mps"] * state.movers[i]["factor"], net.path[net.lanes[lane]["point_from"], CURVE]
        )
        best = min(best, np.sqrt(entry * entry + 2 * _SLOWING_MPS2 * ahead))
        ahead += net.lanes[lane]["length_m"]
    value: float = best
    return value


@kernel
def behind(state: State, i: int, v: float, gap: float, n: int) -> float:
    """How much less mover `i` accelerates because `n` is `gap` ahead."""
    if n < 0:
        return 0.0
    return interaction(v, gap, v - state.movers[n]["speed_mps"], state.movers[i]["headway_s"],
                       state.movers[i]["standing_gap_m"],
                       state.movers[i]["acceleration_mps2"], state.movers[i]["braking_mps2"])  # fmt: skip


@kernel
def before_gate(net: Network, state: State, i: int, v: float, time_s: float) -> float:
    """How much less because of the next gate that one may not enter yet."""
    k, _, ahead = first_gate(net, state, i)
    if k < 0 or ahead > v * v / 3.0 + 2.0 * v + 5.0:
        return 0.0
    is_red = k > HERE and shows(net, state.way[i, k - 1], time_s) < 2
    if not is_red and ahead > v * v / 4.0 + v + 3.0:
        return 0.0
    return interaction(
        v,
        ahead,
        v,
        0.4,
        state.movers[i]["margin_m"],
        state.movers[i]["acceleration_mps2"],
        state.movers[i]["braking_mps2"],
    )


@kernel
def accelerate(net: Network, state: State, taken: Occupancy, time_s: float) -> None:
    """Set everybody's acceleration and brake lights."""
    for i in range(len(state.movers)):
        v = state.movers[i]["speed_mps"]
        a, b = state.movers[i]["acceleration_mps2"], state.movers[i]["braking_mps2"]
        gap, n = leader(net, state, taken, i, 0, far(v))
        less = behind(state, i, v, gap, n)
        side = left_side(state, i)
        if side != 0:
            gap, n = leader(net, state, taken, i, side, far(v))
            less = max(less, behind(state, i, v, gap, n))
        less = max(less, before_gate(net, state, i, v, time_s))
        free = free_acceleration(v, desired_speed(net, state, i), a, b)
        wanted = limited(min(free, a - less) if free > 0.0 and less > a else free - less)
        state.movers[i]["accel_mps2"] = 0.0 if v == 0.0 and wanted < 0.0 else wanted
        state.movers[i]["braking"] = wanted < -_BRAKE_LIGHT_MPS2 or v < _STANDING_MPS
        state.movers[i]["frozen"] = False
