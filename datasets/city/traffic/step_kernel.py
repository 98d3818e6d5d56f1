"""Compiled: one step of everybody."""

from fbench.datasets.city.traffic.change_kernel import change_lanes, extend
from fbench.datasets.city.traffic.follow_kernel import accelerate
from fbench.datasets.city.traffic.gate_kernel import give_rights
from fbench.datasets.city.traffic.network import Network
from fbench.datasets.city.traffic.occupancy_kernel import occupancy
from fbench.datasets.city.traffic.overlap_kernel import stop_before_touching
from fbench.datasets.city.traffic.path_kernel import travelled
from fbench.datasets.city.traffic.state import HERE, WINDOW, State
from fbench.replay.arrays import Float64
from fbench.replay.kernels import kernel


@kernel
def decide(net: Network, state: State, sizes: Float64, step: int, step_s: float) -> None:
    """Set what everybody does from step `step` to the next; `sizes` (N, 2) are lengths and widths."""
    time_s = step * step_s
    taken = occupancy(net, state)
    change_lanes(net, state, taken, step)
    give_rights(net, state, taken, time_s, step_s)
    accelerate(net, state, taken, time_s)
    stop_before_touching(net, state, sizes, step_s)


@kernel
def advance(net: Network, state: State, step_s: float) -> None:
    """Do what was decided."""
    for i in range(len(state.movers)):
        if state.movers[i]["frozen"]:
            state.movers[i]["speed_mps"] = 0.0
            continue
        gone, v = travelled(state.movers[i]["speed_mps"], state.movers[i]["accel_mps2"], step_s)
        state.movers[i]["at_m"] += gone
        state.movers[i]["speed_mps"] = v if v > 1e-3 else 0.0
        while state.movers[i]["at_m"] > net.lanes[state.way[i, HERE]]["length_m"]:
            passed = net.lanes[state.way[i, HERE]]["length_m"]
            state.movers[i]["at_m"] -= passed
            state.movers[i]["base_m"] += passed
            for k in range(WINDOW - 1):
                state.way[i, k] = state.way[i, k + 1]
            state.way[i, WINDOW - 1] = -1
            extend(net, state, i)
