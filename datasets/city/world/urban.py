"""The urban world with its signals and all that stands on its sidewalks, and the worlds by name.

Who turns left gives way to oncoming traffic; that is up to traffic. Between two phases of vehicles there is yellow and
a moment of red for all; whoever is still in the junction goes first. Before pedestrians walk, the last vehicle that
passed the line at the end of the yellow has left the junction; before vehicles go again, the slowest walker who left
the kerb at the green's end has crossed. All junctions share one cycle; where one needs less, vehicles have more green.

A junction, outwards from the crossing street's drive lanes: kerbs bend up to 6.5 m, people cross from 7.2 to 10.8 m,
vehicles wait at 12.5 m. Approaches that face each other are green together, then the others, then all crossings: see
`signal_plan`. Right turns of cars and bicycles are arcs about one center, bicycles inside; left turns are as wide as
fits, 12.4 m and more.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from fbench.datasets.city.spec import WorldName
from fbench.datasets.city.world import urban_lanes
from fbench.datasets.city.world.city_map import CityMap, Draft, Kind, Layout, Placement, SignalPlan, join_points, length
from fbench.datasets.city.world.highway import highway_layout
from fbench.datasets.city.world.street_grid import PARKING_M, Arm, Grid, Node, draw_grid
from fbench.datasets.city.world.urban_ground import block_placements, marking_patches, urban_ground
from fbench.datasets.city.world.urban_lanes import CROSSING_M, SIDEWALK_Z_M
from fbench.replay.conditions.generators import generator
from fbench.replay.data.arrays import Float64

Phases = dict[int, tuple[float, float]]
"""By arm: when in its junction's cycle the green of its approach begins, and how long it lasts."""
_MPS, _STARTS_S = 10.0, 3.0  # How fast one goes to the next junction, and how much longer that takes from a standstill
_STRAIGHT, _TURN = 4.0, 1.0  # How many go where
_SAMPLES = np.linspace(0.05, 0.95, 10)  # Of those who leave during a green
_ROUNDS = 8


@dataclass(frozen=True)
class _Flow:
    """Vehicles that come from one approach to another."""

    before: Node
    after: Node
    weight: float
    came: tuple[float, float]  # Their green at the junction before, as in `Phases`
    goes: tuple[float, float]  # Their green at the junction after it
    travel_s: float


def offsets_s(grid: Grid, phases: dict[Node, Phases], cycle_s: float) -> dict[Node, float]:
    """Choose for each junction when its cycle begins, in whole seconds. One junction after the other takes what makes
    those on its streets wait least, given all others, several times over. The first guess is a wave to the east and
    north.
    """
    candidates, x, y = np.arange(int(cycle_s), dtype=np.float64), grid.x_m, grid.y_m
    offsets = {(i, j): float(np.round((x[i] - x[0] + y[j] - y[0]) / _MPS)) % cycle_s for i, j in grid.nodes}
    flows = []  # from each approach of a junction to each other arm of it, and on to the next junction
    for node in grid.nodes:
        for arm in grid.arms(node):
            travel, goes = _STARTS_S + arm.length_to(grid.opposite(arm)) / _MPS, phases[arm.far][(arm.way + 2) % 4]
            for came in grid.arms(node):
                weight = _STRAIGHT if (came.way - arm.way) % 4 == 2 else _TURN
                if came is not arm:
                    flows.append(_Flow(node, arm.far, weight, phases[node][came.way], goes, travel))
    for _ in range(_ROUNDS):
        for node in grid.nodes:
            waits = np.zeros(len(candidates))
            for flow in flows:
                if flow.after == node:
                    waits += _waits_s(flow, offsets[flow.before] - candidates, cycle_s)
                elif flow.before == node:
                    waits += _waits_s(flow, candidates - offsets[flow.after], cycle_s)
            offsets[node] = float(candidates[np.argmin(np.round(waits, 6))])
    return offsets


def _waits_s(flow: _Flow, earlier_s: Float64, cycle_s: float) -> Float64:
    """What a flow waits (K,), where the cycle of the junction before begins so much later (K,) than the other's."""
    left = flow.came[0] + flow.came[1] * _SAMPLES
    since = (earlier_s[:, None] + left[None, :] + flow.travel_s - flow.goes[0]) % cycle_s
    return np.asarray(flow.weight * np.where(since < flow.goes[1], 0.0, cycle_s - since).mean(axis=1))


YELLOW_S = 3.0
SLOW_WALK_MPS, _SETS_OFF_S = 1.0, 1.5  # The slowest walker, and how much longer because nobody is at full speed at once
_CLEAR_MPS, _LENGTH_M = 10.0, 6.0
"""Speed and length of the vehicle that clears a junction, in turns as fast as these allow: those of RiLSA 2010."""
_ALL_RED_S = 2.0
_GREEN_S, _WALK_GREEN_S = (12.0, 14.0), 5.0


@dataclass(frozen=True)
class Groups:
    """Numbers of signal groups."""

    approaches: dict[tuple[Node, int], int]  # By junction and arm, for drive and bike lanes
    walks: dict[Node, int]  # By junction, for all its crossings


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
    clear, drafts = np.zeros(len(groups.approaches) + len(groups.walks)), {draft.key: draft for draft in lanes}
    for lane in lanes:  # from the end of a group's green until the last whom it let go has left the junction
        if lane.signal is not None:
            clear[lane.signal] = max(clear[lane.signal], *(_leaves_s(drafts[key]) for key in lane.successors))
    clear = np.ceil(clear * 2) / 2
    draw = generator(seed, "urban layout", "signals")
    phases, least, rest, change = {}, {}, {}, YELLOW_S + _ALL_RED_S
    for node in grid.nodes:
        ways = [arm.way for arm in grid.arms(node)]
        # Approaches along one axis go together; at a corner, where nobody meets, both.
        axes = [[way for way in ways if way % 2 == axis] for axis in (0, 1)]
        phases[node] = axes if len(ways) > 2 else [ways]
        least[node] = [float(np.round(draw.uniform(*_GREEN_S))) for _ in phases[node]]
        # The cycle holds more than greens of vehicles; their last phase is cleared before people walk.
        last = max(float(clear[groups.approaches[node, way]]) for way in phases[node][-1])
        rest[node] = (len(phases[node]) - 1) * change + last + _WALK_GREEN_S + float(clear[groups.walks[node]])
    cycle = float(max(sum(least[node]) + rest[node] for node in grid.nodes))
    timed: dict[Node, Phases] = {}
    for node in grid.nodes:
        greens = [s + (cycle - sum(least[node]) - rest[node]) / len(phases[node]) for s in least[node]]
        begins = [k * change + sum(greens[:k]) for k in range(len(greens))]
        timed[node] = {way: (begins[k], greens[k]) for k, ways in enumerate(phases[node]) for way in ways}
    start, green = np.zeros(len(clear)), np.zeros(len(clear))
    for node, offset in offsets_s(grid, timed, cycle).items():
        for way, (begin, lasts) in timed[node].items():
            start[groups.approaches[node, way]], green[groups.approaches[node, way]] = (offset + begin) % cycle, lasts
        walk = groups.walks[node]
        start[walk], green[walk] = (offset - clear[walk] - _WALK_GREEN_S) % cycle, _WALK_GREEN_S
    return SignalPlan(cycle, start, green, YELLOW_S)


def _leaves_s(way: Draft) -> float:
    """When the last whom a green let go onto a way has left it."""
    if way.kind == "walk":
        return _SETS_OFF_S + length(way.points_m) / SLOW_WALK_MPS
    return YELLOW_S + (length(way.points_m) + _LENGTH_M) / min(_CLEAR_MPS, way.speed_mps)


LAMP_REACH_M, LAMP_HEIGHT_M = 2.2, 8.0
_KERB_M = 0.4
_LAMP_SPACING_M, _TREE_SPACING_M = 27.0, 9.0
_SIGNAL_M, _FROM_M = 12.0, 16.0  # Along an arm: signals, and where other things begin

Facing: TypeAlias = Literal["out", "road", "house"]
Size: TypeAlias = tuple[float, float, float]


def furniture(seed: int, grid: Grid, groups: Groups) -> tuple[list[Placement], Float64]:
    """All that stands on the sidewalks, and where the lamps shine from (L, 3): under the tips of the posts' arms."""
    placements, lamps_m = [], []
    for arm in grid.arm.values():
        draw, long = generator(seed, "urban layout", "furniture", *arm.node, arm.way), arm.length_to(grid.opposite(arm))
        both_sides = arm.way < 2 or arm.num_lanes > 1  # lamps are on one side of streets, on both of avenues
        spots = _spots(long, _LAMP_SPACING_M) if both_sides else []
        size = (LAMP_REACH_M, 0.2, LAMP_HEIGHT_M)
        posts = [_at_kerb(arm, "lamp_post", s, size, "road") for s in spots]
        placements += [*_signals(grid, arm, groups), *posts, *_rest(draw, arm, long)]
        for post in posts:
            x, y, _ = post.position_m
            lamps_m.append([x + LAMP_REACH_M * np.cos(post.yaw_rad), y + LAMP_REACH_M * np.sin(post.yaw_rad),
                            SIDEWALK_Z_M + LAMP_HEIGHT_M - 0.2])  # fmt: skip
    return placements, np.array(lamps_m)


def _signals(grid: Grid, arm: Arm, groups: Groups) -> Iterator[Placement]:
    """At the stop line, beyond the junction, and for those who cross at both kerbs."""
    group, walk = groups.approaches[arm.node, arm.way], groups.walks[arm.node]
    yield _at_kerb(arm, "signal", _SIGNAL_M, (0.3, 0.3, 3.4), "out", signal=group)
    ahead = grid.arm.get((arm.node, (arm.way + 2) % 4))
    if ahead is not None:
        x, y = ahead.at(CROSSING_M[0] - 0.2, -ahead.right_kerb_m - _KERB_M)
        yield Placement("signal", (float(x), float(y), SIDEWALK_Z_M), arm.yaw_rad, (0.3, 0.3, 3.4), signal=group)
    for side, left in ((1, arm.left_kerb_m + _KERB_M), (-1, -arm.right_kerb_m - _KERB_M)):
        x, y = arm.at(CROSSING_M[1] + 0.15, left)
        yaw = float((arm.yaw_rad - side * np.pi / 2) % (2 * np.pi))
        yield Placement("signal", (float(x), float(y), SIDEWALK_Z_M), yaw, (0.25, 0.25, 2.6), signal=walk)


def _spots(length_m: float, spacing_m: float) -> list[float]:
    """Evenly along a side, clear of the junctions."""
    num = max(1, round((length_m - 2 * _FROM_M) / spacing_m) + 1)
    return [float(s) for s in np.linspace(_FROM_M, length_m - _FROM_M, num)]


def _rest(draw: np.random.Generator, arm: Arm, length_m: float) -> list[Placement]:
    """A sign, and things between the lamp posts' places: most are trees, where crowns don't reach the drive lanes."""
    placements = [_at_kerb(arm, "sign", length_m - _FROM_M + 1.5, (0.1, 0.6, 2.6), "out", int(draw.integers(1 << 30)))]
    for s in _spots(length_m, _TREE_SPACING_M):
        spot = s + 3.0 + float(draw.uniform(-0.7, 0.7))
        chosen, variant = float(draw.random()), int(draw.integers(1 << 30))
        wide, high = float(draw.uniform(2.6, 3.8)), float(draw.uniform(6, 8.5))
        things: tuple[tuple[float, Kind, Size, Facing], ...] = (
            (0.62, "tree", (wide, wide, high), "road"), (0.70, "bench", (0.45, 1.6, 0.85), "house"),
            (0.80, "bin", (0.4, 0.4, 0.9), "house"), (0.85, "hydrant", (0.3, 0.3, 0.8), "road"),
        )  # fmt: skip
        for _, kind, size, facing in [thing for thing in things if chosen < thing[0]][:1]:
            if spot < length_m - _FROM_M - 1 and (kind != "tree" or arm.left_extra_m >= PARKING_M):
                placements.append(_at_kerb(arm, kind, spot, size, facing, variant))
    return placements


def _at_kerb(
    arm: Arm, kind: Kind, along_m: float, size_lwh_m: Size, facing: Facing, variant: int = 0, signal: int | None = None
) -> Placement:
    """Something beside the kerb on the left of an arm."""
    x, y = arm.at(along_m, arm.left_kerb_m + _KERB_M)
    turn = {"out": 0.0, "road": -np.pi / 2, "house": np.pi / 2}[facing]
    yaw = float((arm.yaw_rad + turn) % (2 * np.pi))
    return Placement(kind, (float(x), float(y), SIDEWALK_Z_M), yaw, size_lwh_m, variant, signal)


def urban_layout(seed: int) -> Layout:
    """Lay out a world of 4 x 4 junctions, about 400 m wide."""
    grid = draw_grid(seed)
    groups = signal_groups(grid)
    drafts = [
        *urban_lanes.drive_lanes(grid, groups.approaches),
        *urban_lanes.bike_lanes(grid, groups.approaches),
        *urban_lanes.walk_lanes(grid, groups.walks),
    ]
    signals, lanes = signal_plan(seed, grid, groups, drafts), join_points(drafts)
    standing, lamps_m = furniture(seed, grid, groups)
    regions, ground = urban_ground(seed, grid)
    city_map = CityMap("urban", lanes, signals, regions, urban_lanes.parkings(grid), lamps_m)
    return Layout(city_map, (*ground, *marking_patches(grid)), (*block_placements(seed, grid), *standing))


def layout(world: WorldName, seed: int) -> Layout:
    """Lay out a world; the same for the same seed, another for another."""
    return urban_layout(seed) if world == "urban" else highway_layout(seed)
