"""When the cycles of junctions begin: so that whoever leaves one junction waits little at the next one."""

from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.world.street_grid import Grid, Node
from fbench.replay.arrays import Float64

Phases = dict[int, tuple[float, float]]
"""By arm: when in its junction's cycle the green of its approach begins, and how long it lasts."""
_MPS, _STARTS_S = 10.0, 3.0
"""How fast one goes to the next junction, and how much longer that takes from a standstill."""
_STRAIGHT, _TURN = 4.0, 1.0
"""How many go where."""
_SAMPLES = np.linspace(0.05, 0.95, 10)
"""Of those who leave during a green."""
_ROUNDS = 8


@dataclass(frozen=True)
class _Flow:
    """Vehicles that come from one approach to another."""

    before: Node
    after: Node
    weight: float
    came: tuple[float, float]
    """Their green at the junction before, as in `Phases`."""
    goes: tuple[float, float]
    """Their green at the junction after it."""
    travel_s: float


def offsets_s(grid: Grid, phases: dict[Node, Phases], cycle_s: float) -> dict[Node, float]:
    """Choose for each junction when its cycle begins, in whole seconds.

    One junction after the other takes what makes those on its streets wait least, given all others, several times
    over. The first guess is a wave to the east and north.
    """
    candidates = np.arange(int(cycle_s), dtype=np.float64)
    found = {node: _first_s(grid, node) % cycle_s for node in grid.nodes}
    flows = [flow for node in grid.nodes for flow in _flows(grid, phases, node)]
    for _ in range(_ROUNDS):
        for node in grid.nodes:
            waits = np.zeros(len(candidates))
            for flow in flows:
                if flow.after == node:
                    waits += _waits_s(flow, found[flow.before] - candidates, cycle_s)
                elif flow.before == node:
                    waits += _waits_s(flow, candidates - found[flow.after], cycle_s)
            found[node] = float(candidates[np.argmin(np.round(waits, 6))])
    return found


def _flows(grid: Grid, phases: dict[Node, Phases], node: Node) -> list[_Flow]:
    """From each approach of a junction to each other arm of it, and on to the next junction."""
    flows = []
    for arm in grid.arms(node):
        travel, goes = _STARTS_S + arm.length_to(grid.opposite(arm)) / _MPS, phases[arm.far][(arm.way + 2) % 4]
        for came in grid.arms(node):
            weight = _STRAIGHT if (came.way - arm.way) % 4 == 2 else _TURN
            if came is not arm:
                flows.append(_Flow(node, arm.far, weight, phases[node][came.way], goes, travel))
    return flows


def _first_s(grid: Grid, node: Node) -> float:
    (i, j), (x, y) = node, (grid.x_m, grid.y_m)
    return float(np.round((x[i] - x[0] + y[j] - y[0]) / _MPS))


def _waits_s(flow: _Flow, earlier_s: Float64, cycle_s: float) -> Float64:
    """What a flow waits (K,), where the cycle of the junction before begins so much later (K,) than the other's."""
    left = flow.came[0] + flow.came[1] * _SAMPLES
    since = (earlier_s[:, None] + left[None, :] + flow.travel_s - flow.goes[0]) % cycle_s
    return np.asarray(flow.weight * np.where(since < flow.goes[1], 0.0, cycle_s - since).mean(axis=1))
