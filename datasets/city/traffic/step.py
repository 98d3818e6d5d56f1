"""One step of everybody."""

from fbench.datasets.city.traffic.advance_kernel import extend, move
from fbench.datasets.city.traffic.change_kernel import change_lanes
from fbench.datasets.city.traffic.follow_kernel import accelerate
from fbench.datasets.city.traffic.gate_kernel import asking_movers, give_rights, holders, take_back
from fbench.datasets.city.traffic.lights import lights_at
from fbench.datasets.city.traffic.near import near_pairs
from fbench.datasets.city.traffic.network import Network
from fbench.datasets.city.traffic.occupancy_kernel import Occupancy, occupancy
from fbench.datasets.city.traffic.overlap_kernel import MARGIN_M, stop_before_touching
from fbench.datasets.city.traffic.path_kernel import poses
from fbench.datasets.city.traffic.state import CHANGE, EMERGENCY, State
from fbench.replay.arrays import Array, Float64


def decide(net: Network, state: State, sizes: Float64, step: int, step_s: float) -> None:
    """Set what everybody does from step `step` to the next; `sizes` (N, 2) are lengths and widths."""
    taken, lights, roads = occupied(net, state), lights_at(net, step * step_s), net.roads
    num_changed = change_lanes(roads, net.gates, state.movers, state.way, taken, step)
    if num_changed:
        extend(net.lanes, net.nexts, state.movers, state.way, state.choices)
    _give_rights(net, state, taken, lights, step_s)
    accelerate(roads, net.gates, lights, state.movers, state.way, taken)
    state.counters[CHANGE] += num_changed
    state.counters[EMERGENCY] += _stop_before_touching(net, state, sizes, step_s)


def _give_rights(net: Network, state: State, taken: Occupancy, lights: Array, step_s: float) -> None:
    take_back(net.lanes, lights, state.movers, state.way)
    held = holders(net.lanes, state.movers, state.way)
    asking = asking_movers(net.roads, net.gates, lights, state.movers, state.way, taken, step_s)
    give_rights(net.lanes, net.gates, net.conflicts, lights, state.movers, state.way, taken, held, asking)


def _stop_before_touching(net: Network, state: State, sizes: Float64, step_s: float) -> int:
    now, then = poses_of(net, state, 0.0), poses_of(net, state, step_s)
    return stop_before_touching(state.movers, now, then, sizes, near_pairs(now, then, sizes, MARGIN_M))


def advance(net: Network, state: State, step_s: float) -> None:
    """Do what was decided."""
    move(net.lanes, state.movers, state.way, step_s)
    extend(net.lanes, net.nexts, state.movers, state.way, state.choices)


def occupied(net: Network, state: State) -> Occupancy:
    """Find who is where on each lane."""
    return occupancy(net.path, net.lanes, state.movers, state.way)


def poses_of(net: Network, state: State, since_s: float) -> Float64:
    """Poses (N, 9) of all movers, `since_s` after the step's beginning; see `poses`."""
    return poses(net.path, net.lanes, state.movers, state.way, since_s)
