"""Conflicts of lanes, and the gates that one enters only with the right to them."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fbench.datasets.city.world.city_map import Lane, LaneKind
from fbench.replay.data.arrays import Array, Bool, Float64, Int64

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


def splits_of(conflicts: Conflicts, num_lanes: int) -> tuple[Array, Array]:
    """Return where each lane's rows begin (L + 1,), and the rows of `SPLIT`."""
    lane = conflicts.lane[conflicts.parts]
    rows = np.zeros(len(lane), SPLIT)
    rows["lane"], rows["until_m"] = conflicts.other[conflicts.parts], conflicts.other_to_m[conflicts.parts]
    return np.searchsorted(lane, np.arange(num_lanes + 1)), rows


def gates_of(lanes: tuple[Lane, ...], along: list[Float64], conflicts: Conflicts) -> tuple[Array, Array, Array]:
    """Return where each lane's gates begin (L + 1,), rows of `GATE`, and rows of `CONFLICT`.

    Whole lanes in junctions, and lanes after a signal, are one gate from their beginning; elsewhere a gate is where
    other lanes come near.
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
