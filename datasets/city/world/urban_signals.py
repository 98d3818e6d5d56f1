"""Signals of the urban world: one approach after the other, then all pedestrians; never two at once.

A junction's cycle is: for each approach green, yellow, and red for all until the slowest vehicle that passed the line
at the end of the yellow has left the junction; then green for pedestrians, and red for all until the slowest of them
who left the kerb at its end has crossed. All junctions share one cycle; where one needs less, greens are longer.
"""

from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.world.city_map import SignalPlan
from fbench.datasets.city.world.lane_graph import Draft
from fbench.datasets.city.world.lane_paths import length
from fbench.datasets.city.world.street_grid import Grid, Node
from fbench.replay.arrays import Float64
from fbench.replay.draws import generator

YELLOW_S = 3.0
LONGEST_M = 12.0
"""The longest vehicle: a bus."""
SLOW_MPS, SLOW_WALK_MPS = 5.0, 1.0
_GREEN_S, _WALK_GREEN_S = (8.0, 10.0), 6.0


@dataclass(frozen=True)
class Groups:
    """Numbers of signal groups."""

    approaches: dict[tuple[Node, int], int]
    """By junction and arm, for drive and bike lanes."""
    walks: dict[Node, int]
    """By junction, for all its crossings."""


def signal_groups(grid: Grid) -> Groups:
    """Number the groups, junction by junction."""
    approaches: dict[tuple[Node, int], int] = {}
    walks: dict[Node, int] = {}
    for node in grid.nodes:
        for arm in grid.arms(node):
            approaches[node, arm.way] = len(approaches) + len(walks)
        walks[node] = len(approaches) + len(walks)
    return Groups(approaches, walks)


def signal_plan(seed: int, grid: Grid, groups: Groups, lanes: list[Draft]) -> SignalPlan:
    """Time all junctions; `lanes` are all of the world."""
    clear = _clearances_s(groups, lanes)
    draw = generator(seed, "urban layout", "signals")
    least = np.round(draw.uniform(*_GREEN_S, len(clear)))
    least[list(groups.walks.values())] = _WALK_GREEN_S
    phases = [
        [*(groups.approaches[node, arm.way] for arm in grid.arms(node)), groups.walks[node]] for node in grid.nodes
    ]
    cycle = float(max(sum(least[i] + clear[i] for i in phase) for phase in phases))
    start, green = np.zeros(len(clear)), np.zeros(len(clear))
    for phase in phases:
        spare = (cycle - sum(least[i] + clear[i] for i in phase)) / len(phase)
        now = float(np.floor(draw.uniform(0, cycle)))
        for i in phase:
            start[i], green[i] = now % cycle, least[i] + spare
            now += green[i] + clear[i]
    return SignalPlan(cycle, start, green, YELLOW_S)


def _clearances_s(groups: Groups, lanes: list[Draft]) -> Float64:
    """From the end of a group's green to the next green of its junction, (G,)."""
    drafts = {draft.key: draft for draft in lanes}
    clear = np.zeros(len(groups.approaches) + len(groups.walks))
    for lane in lanes:
        if lane.signal is not None:
            needed = max(_needed_s(drafts[key]) for key in lane.successors)
            clear[lane.signal] = max(clear[lane.signal], needed)
    return np.ceil(clear * 2) / 2


def _needed_s(way: Draft) -> float:
    if way.kind == "walk":
        return length(way.points_m) / SLOW_WALK_MPS
    return YELLOW_S + (length(way.points_m) + LONGEST_M) / min(SLOW_MPS, way.speed_mps)
