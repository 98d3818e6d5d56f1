"""The lanes of a map and everybody on them as flat arrays for compiled code; where lanes meet, and the gates that one
enters only with the right to them.
"""

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from fbench.datasets.city.world.city_map import CityMap, Lane, LaneKind
from fbench.replay.data.arrays import Array, Bool, Float64, Int64

WINDOW, HERE = 14, 4  # How many lanes of its way each mover keeps, and which of them it is on
NUM_CHOICES = 512  # Numbers drawn for each mover to choose its ways with, over and over
AXLE = 0.3  # Axles before and behind the middle of the footprint, as a share of the length
EMERGENCY, CHANGE = 0, 1  # Counters: bodies stopped at once because they would have touched another; lane changes
CHANGE_S = 3.5  # How long a change of lanes takes
MOVER = np.dtype([
    # what each is like
    ("length_m", "f8"), ("width_m", "f8"), ("kind", "i8"), ("factor", "f8"), ("fastest_mps", "f8"), ("headway_s", "f8"),
    ("standing_gap_m", "f8"), ("acceleration_mps2", "f8"), ("braking_mps2", "f8"), ("margin_m", "f8"),
    ("keeps_right", "?"), ("cycle_m", "f8"),
    # where it is, at the beginning of a step
    ("at_m", "f8"), ("base_m", "f8"), ("speed_mps", "f8"), ("side_m", "f8"), ("side_from_m", "f8"),
    ("side_for_m", "f8"),
    # what it does until the end of the step
    ("accel_mps2", "f8"), ("frozen", "?"), ("braking", "?"),
    # what it has in mind
    ("right_to_m", "f8"), ("waited_s", "f8"), ("num_chosen", "i8"),
])  # fmt: skip
"""One mover.

kind: of its lanes. factor: on speed limits. headway_s, standing_gap_m, acceleration_mps2, braking_mps2: T, s0, a, b of
the IDM. margin_m: before a line to stop at. keeps_right: never uses the leftmost lane. cycle_m: how far a cycle of gait
or pedals goes, 0 for none. at_m: the middle of its footprint along the lane `HERE` of its way. base_m: distance
traveled up to the beginning of that lane. side_m: how far left of its lane it was when it began
a change of lanes, which each of its axles makes from `side_from_m` of the distance traveled on, over `side_for_m`.
accel_mps2: constant, until it stands. frozen: was stopped at once.
right_to_m: distance traveled up to which it may enter gates. waited_s: at a gate, where only others are in its way.
"""


class State(NamedTuple):
    """N movers; compiled code changes the arrays."""

    movers: Array  # (N,) of `MOVER`
    way: Array
    """(N, WINDOW) lanes in the order of travel; -1 far behind where the first one has none that leads to it. Movers
    begin wholly on their lane, so no body is there.
    """
    choices: Float64  # (N, NUM_CHOICES) from 0 to below 1
    counters: Array  # (2,): `EMERGENCY`, `CHANGE`


_WIDTH_M = 2.55  # Of trucks and buses (the European limit)
_INSIDE_M, _OUTSIDE_M = 0.15, 0.3  # How far beyond its lane a body may reach
_SHORT_M, _STEP_M = 7.0, 0.25  # All lanes are made for vehicles up to here


def usable_lengths(lanes: tuple[Lane, ...], along: list[Float64], tangents: list[Float64]) -> Float64:
    """Length (L,) of the longest vehicle that may use a lane, and that is never led to where it may not go on."""
    longest = np.array([lane.longest_m for lane in lanes])
    for i, (lane, a, t) in enumerate(zip(lanes, along, tangents, strict=True)):
        bend = float(np.quantile(_bends(a, t), 0.9))
        if lane.kind == "drive" and bend >= 1e-3:
            longest[i] = min(lane.longest_m, longest_in_curve(1 / bend, lane.width_m))
    while True:
        onwards = np.array([max(longest[list(lane.successors)]) for lane in lanes])
        if (longest <= onwards).all():
            return longest
        longest = np.minimum(longest, onwards)


def _bends(along: Float64, tangent: Float64) -> Float64:
    """Curvature [1/m] between points."""
    cross = tangent[:-1, 0] * tangent[1:, 1] - tangent[:-1, 1] * tangent[1:, 0]
    return np.asarray(np.abs(np.arcsin(np.clip(cross, -1, 1))) / np.diff(along))


def longest_in_curve(radius_m: float, lane_m: float) -> float:
    """Length of the longest vehicle that, its axles on an arc, hardly leaves its lane. Its middle is on a circle of
    sqrt(R^2 - a^2) with the axles a before and behind it; the inner side reaches half its width inside, the front
    corners sqrt((r + w/2)^2 + (l/2)^2) outside.
    """
    length = np.arange(_SHORT_M, 25.0, _STEP_M)
    axles = np.minimum(AXLE * length, radius_m)
    middle = np.sqrt(radius_m**2 - axles**2)
    inner = middle - _WIDTH_M / 2 >= radius_m - lane_m / 2 - _INSIDE_M
    outer = np.hypot(middle + _WIDTH_M / 2, length / 2) <= radius_m + lane_m / 2 + _OUTSIDE_M
    return float(length[np.append(np.flatnonzero(~(inner & outer)), len(length) - 1)[0]])


DRIVE, BIKE, WALK = 0, 1, 2
KINDS = {"drive": DRIVE, "bike": BIKE, "walk": WALK}
_LATERAL_MPS2 = 2.8
"""Lateral acceleration that drivers accept in curves (chosen; about 2 is comfortable, 3 and more is felt as brisk)."""
_SLOWING_MPS2 = 1.2  # How hard they brake before a curve
_CRAWL_MPS = 1.0
ALONG, CURVE = 5, 6  # Columns of `Network.path`
LANE = np.dtype([
    ("length_m", "f8"), ("speed_mps", "f8"), ("longest_m", "f8"), ("kind", "i8"), ("left", "i8"), ("right", "i8"),
    ("signal", "i8"), ("point_from", "i8"), ("point_to", "i8"), ("next_from", "i8"), ("next_to", "i8"),
    ("split_from", "i8"), ("split_to", "i8"), ("gate_from", "i8"), ("gate_to", "i8"), ("turns_left", "i8"),
])  # fmt: skip
"""A lane; -1 for no neighbor and no signal; `_from` and `_to` are rows of the other arrays. turns_left: crosses
oncoming traffic, which goes first."""
NEXT = np.dtype([("lane", "i8"), ("weight", "f8")])  # A successor, and how often it is chosen
GROUP = np.dtype([("green_from_s", "f8"), ("green_s", "f8")])


class Roads(NamedTuple):
    """What one needs to find who is ahead; fields of `Network`. Kernels take what they need: a whole `Network` as an
    argument takes them much longer to compile.
    """

    path: Float64
    lanes: Array
    splits: Array


class Network(NamedTuple):
    """A map, prepared."""

    path: Float64
    """(P, 7) points of all lanes: x, y, z, unit tangent in x and y, length up to there, speed that the curves allow."""
    lanes: Array  # (L,) of `LANE`
    nexts: Array  # (S,) of `NEXT`
    splits: Array  # Of `SPLIT`: lanes that begin where a lane begins
    gates: Array  # Of `GATE`: stretches of lanes that others cross or join; nobody enters one without the right to it
    conflicts: Array  # Of `CONFLICT`: what meets a gate
    groups: Array  # Of `GROUP`: signals
    cycle_s: float
    yellow_s: float

    @property
    def roads(self) -> Roads:
        """Some of the fields."""
        return Roads(self.path, self.lanes, self.splits)


def network_of(city_map: CityMap) -> Network:
    """Prepare the lanes of a map."""
    lanes, signals = city_map.lanes, city_map.signals
    along, tangents = [lane_lengths(lane) for lane in lanes], lane_tangents(lanes)
    pairs = conflicts_of(lanes, along)
    splits = np.zeros(np.count_nonzero(pairs.parts), SPLIT)
    splits["lane"], splits["until_m"] = pairs.other[pairs.parts], pairs.other_to_m[pairs.parts]
    split_starts = np.searchsorted(pairs.lane[pairs.parts], np.arange(len(lanes) + 1))
    gate_starts, gates, conflicts = gates_of(lanes, along, pairs)
    # Straight on is chosen most often; who turns left holds up those behind, so few do.
    weights = [4.0 if (t[0] * t[-1]).sum() > 0.7 else 0.25 if _turns_left(t) else 1.5 for t in tangents]
    nexts = [(k, weights[k]) for lane in lanes for k in lane.successors]
    groups = zip(signals.green_from_s, signals.green_s, strict=True)
    path = [np.column_stack([lane.points_m, t, a, _curve_speeds(a, t)])
            for lane, a, t in zip(lanes, along, tangents, strict=True)]  # fmt: skip
    rows = np.zeros(len(lanes), LANE)
    starts = {"point": np.cumsum([0, *(len(a) for a in along)]), "split": split_starts, "gate": gate_starts,
              "next": np.cumsum([0, *(len(lane.successors) for lane in lanes)])}  # fmt: skip
    for name, begin in starts.items():
        rows[f"{name}_from"], rows[f"{name}_to"] = begin[:-1], begin[1:]
    rows["length_m"], rows["kind"] = [a[-1] for a in along], [KINDS[lane.kind] for lane in lanes]
    rows["speed_mps"], rows["longest_m"] = [lane.speed_mps for lane in lanes], usable_lengths(lanes, along, tangents)
    rows["turns_left"] = [lane.kind == "drive" and lane.in_junction and _turns_left(t)
                          for lane, t in zip(lanes, tangents, strict=True)]  # fmt: skip
    for name in ("left", "right", "signal"):
        rows[name] = [-1 if getattr(lane, name) is None else getattr(lane, name) for lane in lanes]
    return Network(
        np.concatenate(path), rows, np.array(nexts, NEXT), splits, gates, conflicts,
        np.array(list(groups), GROUP), float(signals.cycle_s), float(signals.yellow_s),
    )  # fmt: skip


def lane_tangents(lanes: tuple[Lane, ...]) -> list[Float64]:
    """Directions (P, 2) at each lane's points, the same for all lanes that meet at a node."""
    tangents = [_tangents(lane.points_m[:, :2]) for lane in lanes]
    for group in _nodes(lanes):
        mean = np.sum([tangents[lane][row] for lane, row in group], axis=0)
        mean = mean / np.sqrt((mean * mean).sum())
        for lane, row in group:
            tangents[lane][row] = mean
    return tangents


def lane_lengths(lane: Lane) -> Float64:
    """Length (P,) of a lane up to each of its points."""
    steps = np.diff(lane.points_m[:, :2], axis=0)
    return np.concatenate([[0.0], np.cumsum(np.sqrt((steps * steps).sum(axis=1)))])


def _tangents(points: Float64) -> Float64:
    """Of a parabola through each point and its neighbors."""
    step = np.diff(points, axis=0)
    h = np.sqrt((step * step).sum(axis=1))[:, None]
    slope = step / h
    inner = (slope[:-1] * h[1:] + slope[1:] * h[:-1]) / (h[:-1] + h[1:])
    ends = (2 * slope[:1] - inner[:1], 2 * slope[-1:] - inner[-1:]) if len(inner) else (slope, slope)
    tangent = np.concatenate([ends[0], inner, ends[1]])
    return np.asarray(tangent / np.sqrt((tangent * tangent).sum(axis=1))[:, None], np.float64)


def _nodes(lanes: tuple[Lane, ...]) -> list[list[tuple[int, int]]]:
    """Ends (lane, -1) and beginnings (lane, 0) that lie on the same node."""
    parent = list(range(2 * len(lanes)))

    def root(i: int) -> int:
        while parent[i] != i:
            i = parent[i]
        return i

    for i, lane in enumerate(lanes):
        for k in lane.successors:
            parent[root(2 * k)] = root(2 * i + 1)
    groups: dict[int, list[tuple[int, int]]] = {}
    for i, end in product(range(len(lanes)), (0, -1)):
        groups.setdefault(root(2 * i - end), []).append((i, end))
    return list(groups.values())


def _curve_speeds(along: Float64, tangent: Float64) -> Float64:
    """Speed (P,) that keeps v^2 / R in curves, with room to brake before them."""
    bend = _bends(along, tangent)
    at = np.maximum(np.append(bend, 0.0), np.append(0.0, bend))
    speed = np.maximum(np.sqrt(_LATERAL_MPS2 / np.maximum(at, 1e-6)), _CRAWL_MPS)
    for i in range(len(speed) - 2, -1, -1):
        speed[i] = min(speed[i], np.sqrt(speed[i + 1] ** 2 + 2 * _SLOWING_MPS2 * (along[i + 1] - along[i])))
    return np.asarray(speed, np.float64)


def _turns_left(tangent: Float64) -> bool:
    return float(tangent[0, 0] * tangent[-1, 1] - tangent[0, 1] * tangent[-1, 0]) > 0.7


HALF_WIDTH_M: dict[LaneKind, float] = {"drive": 1.3, "bike": 0.4, "walk": 0.3}
"""Half of the widest body, a bus, a bicycle with its rider, a person."""
_MARGIN_M = {"drive": 0.3, "bike": 0.2, "walk": 0.05}  # What is kept free beside it
_SAMPLE_M = 0.25
_JOINED_M = 6.0  # Lanes that follow each other over shorter ones than this are one way, not two that meet


@dataclass(frozen=True, eq=False)
class Conflicts:
    """C pairs of lanes, each both ways, sorted by lane and other."""

    lane: Int64
    other: Int64
    lane_from_m: Float64
    lane_to_m: Float64  # (C,) the stretch of the lane from which a body reaches into the other lane
    other_from_m: Float64
    other_to_m: Float64
    parts: Bool  # (C,) whether both begin at the same node and the stretch is there: one follows whoever is ahead


def conflicts_of(lanes: tuple[Lane, ...], along: list[Float64]) -> Conflicts:
    """Find all pairs of lanes that meet."""
    ats, points = [], []
    for lane, a in zip(lanes, along, strict=True):
        ats.append(np.linspace(0, a[-1], max(int(a[-1] / _SAMPLE_M), 2) + 1))
        points.append(np.column_stack([np.interp(ats[-1], a, lane.points_m[:, k]) for k in range(2)]))
    index, at = np.repeat(np.arange(len(ats)), [len(s) for s in ats]), np.concatenate(ats)
    half = np.array([HALF_WIDTH_M[lane.kind] for lane in lanes])
    margin = np.array([_MARGIN_M[lane.kind] for lane in lanes])
    tree = cKDTree(np.concatenate(points))
    pairs = tree.query_pairs(2 * (half.max() + margin.max()), output_type="ndarray")
    i, j = index[pairs[:, 0]], index[pairs[:, 1]]
    apart = tree.data[pairs[:, 0]] - tree.data[pairs[:, 1]]
    near = np.sqrt((apart * apart).sum(axis=1)) < half[i] + half[j] + np.maximum(margin[i], margin[j])
    followed = _follow(lanes, along)
    rows = pairs[near & (i != j) & ~followed[i, j] & ~followed[j, i]]
    both = np.concatenate([rows, rows[:, ::-1]])
    i, j = index[both[:, 0]], index[both[:, 1]]
    order = np.lexsort((j, i))
    i, j, s, t = i[order], j[order], at[both[order, 0]], at[both[order, 1]]
    first = np.flatnonzero(np.concatenate([[True], (np.diff(i) != 0) | (np.diff(j) != 0)])[: len(i)])
    lane_of, other = i[first].astype(np.int64), j[first].astype(np.int64)
    low, high = np.minimum.reduceat(s, first), np.maximum.reduceat(s, first)
    other_low, other_high = np.minimum.reduceat(t, first), np.maximum.reduceat(t, first)
    siblings = np.zeros((len(lanes), len(lanes)), bool)
    for lane in lanes:
        siblings[np.ix_(lane.successors, lane.successors)] = True
    parts = siblings[lane_of, other] & (low < 0.5) & (other_low < 0.5)
    return Conflicts(lane_of, other, low, high, other_low, other_high, parts)


def _follow(lanes: tuple[Lane, ...], along: list[Float64]) -> Bool:
    """(L, L) whether the second lane follows the first at once or over short lanes, or runs beside it for changes."""
    result = np.zeros((len(lanes), len(lanes)), bool)
    for i, lane in enumerate(lanes):
        ahead = [(k, 0.0) for k in lane.successors]
        while ahead:
            k, far = ahead.pop()
            result[i, k] = True
            if far + along[k][-1] < _JOINED_M:
                ahead += [(n, far + along[k][-1]) for n in lanes[k].successors]
        result[i, [k for k in (lane.left, lane.right) if k is not None]] = True
    return result


_APART_M = 2.0  # Stretches that are nearer to each other become one
GATE = np.dtype([("from_m", "f8"), ("to_m", "f8"), ("conflict_from", "i8"), ("conflict_to", "i8")])
"""A stretch of a lane, and rows of what meets it."""
CONFLICT = np.dtype([("lane", "i8"), ("from_m", "f8"), ("to_m", "f8")])
"""Another lane, and where along it a body would be in the way."""
SPLIT = np.dtype([("lane", "i8"), ("until_m", "f8")])
"""A lane that begins at the same node, and how far along it a body is still in the way."""


def gates_of(lanes: tuple[Lane, ...], along: list[Float64], conflicts: Conflicts) -> tuple[Array, Array, Array]:
    """Return where each lane's gates begin (L + 1,), rows of `GATE`, and rows of `CONFLICT`. Whole lanes in junctions,
    and lanes after a signal, are one gate from their beginning; elsewhere a gate is where other lanes come near.
    """
    after_signal = {k for lane in lanes if lane.signal is not None for k in lane.successors}
    first: list[int] = [0]
    gates: list[tuple[float, float, int, int]] = []
    rows: list[int] = []
    for i, lane in enumerate(lanes):
        mine = np.flatnonzero((conflicts.lane == i) & ~conflicts.parts)
        spans: list[tuple[float, float, list[int]]] = []
        if lane.in_junction or i in after_signal:
            spans = [(0.0, float(along[i][-1]), mine.tolist())]
        else:
            for row in mine[np.argsort(conflicts.lane_from_m[mine], kind="stable")].tolist():
                begin, end = float(conflicts.lane_from_m[row]), float(conflicts.lane_to_m[row])
                if spans and begin < spans[-1][1] + _APART_M:
                    before = spans.pop()
                    spans.append((before[0], max(before[1], end), [*before[2], row]))
                else:
                    spans.append((begin, end, [row]))
        for begin, end, members in spans:
            gates.append((begin, end, len(rows), len(rows) + len(members)))
            rows += members
        first.append(len(gates))
    taken, met = np.array(rows, np.int64), np.zeros(len(rows), CONFLICT)
    met["lane"], met["from_m"] = conflicts.other[taken], conflicts.other_from_m[taken]
    met["to_m"] = conflicts.other_to_m[taken]
    return np.array(first), np.array(gates, GATE), met
