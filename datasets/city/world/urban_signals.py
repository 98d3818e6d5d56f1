"""Signals of the urban world: approaches that face each other go together, then the others, then all pedestrians.

Who turns left gives way to oncoming traffic; that is up to traffic. Between two phases of vehicles there is yellow and
a moment of red for all; whoever is still in the junction goes first. Before pedestrians walk, the last vehicle that
passed the line at the end of the yellow has left the junction; before vehicles go again, the slowest walker who left
the kerb at the green's end has crossed. All junctions share one cycle; where one needs less, vehicles have more green.
"""

from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.world.city_map import SignalPlan
from fbench.datasets.city.world.lane_graph import Draft
from fbench.datasets.city.world.lane_paths import length
from fbench.datasets.city.world.street_grid import Grid, Node
from fbench.datasets.city.world.urban_offsets import Phases, offsets_s
from fbench.replay.arrays import Float64
from fbench.replay.draws import generator

YELLOW_S = 3.0
SLOW_WALK_MPS, _SETS_OFF_S = 1.0, 1.5
"""The slowest walker, and how much longer because nobody is at full speed at once."""
_CLEAR_MPS, _LENGTH_M = 10.0, 6.0
"""Speed and length of the vehicle that clears a junction, in turns as fast as these allow: those of RiLSA 2010."""
_ALL_RED_S = 2.0
_GREEN_S, _WALK_GREEN_S = (12.0, 14.0), 5.0


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
    phases = {node: _phases(grid, node) for node in grid.nodes}
    least = {node: [float(np.round(draw.uniform(*_GREEN_S))) for _ in phases[node]] for node in grid.nodes}
    rest = {node: _rest_s(groups, clear, node, phases[node]) for node in grid.nodes}
    cycle = float(max(sum(least[node]) + rest[node] for node in grid.nodes))
    timed = {
        node: _timed(phases[node], [s + (cycle - sum(least[node]) - rest[node]) / len(phases[node])
                                    for s in least[node]])
        for node in grid.nodes
    }  # fmt: skip
    start, green = np.zeros(len(clear)), np.zeros(len(clear))
    for node, offset in offsets_s(grid, timed, cycle).items():
        for way, (begin, lasts) in timed[node].items():
            start[groups.approaches[node, way]], green[groups.approaches[node, way]] = (offset + begin) % cycle, lasts
        walk = groups.walks[node]
        start[walk], green[walk] = (offset - clear[walk] - _WALK_GREEN_S) % cycle, _WALK_GREEN_S
    return SignalPlan(cycle, start, green, YELLOW_S)


def _phases(grid: Grid, node: Node) -> list[list[int]]:
    """Arms whose approaches go together: those along one axis; at a corner, where nobody meets, both."""
    ways = [arm.way for arm in grid.arms(node)]
    axes = [[way for way in ways if way % 2 == axis] for axis in (0, 1)]
    return axes if len(ways) > 2 else [ways]


def _rest_s(groups: Groups, clear: Float64, node: Node, phases: list[list[int]]) -> float:
    """What a cycle holds besides greens of vehicles; the last phase of these is cleared before people walk."""
    last = max(float(clear[groups.approaches[node, way]]) for way in phases[-1])
    between = (len(phases) - 1) * (YELLOW_S + _ALL_RED_S)
    return between + last + _WALK_GREEN_S + float(clear[groups.walks[node]])


def _timed(phases: list[list[int]], greens: list[float]) -> Phases:
    begins = [k * (YELLOW_S + _ALL_RED_S) + sum(greens[:k]) for k in range(len(phases))]
    return {way: (begins[k], greens[k]) for k, ways in enumerate(phases) for way in ways}


def _clearances_s(groups: Groups, lanes: list[Draft]) -> Float64:
    """From the end of a group's green until the last whom it let go has left the junction, (G,)."""
    drafts = {draft.key: draft for draft in lanes}
    clear = np.zeros(len(groups.approaches) + len(groups.walks))
    for lane in lanes:
        if lane.signal is not None:
            needed = max(_needed_s(drafts[key]) for key in lane.successors)
            clear[lane.signal] = max(clear[lane.signal], needed)
    return np.ceil(clear * 2) / 2


def _needed_s(way: Draft) -> float:
    if way.kind == "walk":
        return _SETS_OFF_S + length(way.points_m) / SLOW_WALK_MPS
    return YELLOW_S + (length(way.points_m) + _LENGTH_M) / min(_CLEAR_MPS, way.speed_mps)
