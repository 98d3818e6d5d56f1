"""Maps: lanes as a graph, signals, regions and parked cars, and the plan of the static world."""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from fbench.replay.data.arrays import Array, Bool, Float64

LaneKind: TypeAlias = Literal["drive", "bike", "walk"]


@dataclass(frozen=True, eq=False)
class Lane:
    """One lane between two nodes of the graph, in its direction of travel."""

    points_m: Float64
    """(P, 3) center line in the world, from the first point to the last, at most 1 m apart; smooth, and continued
    smoothly by the first point of each successor, which is equal to its last."""
    width_m: float
    speed_mps: float  # How fast one may go
    kind: LaneKind
    successors: tuple[int, ...]  # Indices of the lanes that go on from its end; never empty: networks are closed
    left: int | None = None
    """Index of the parallel lane on the left with the same direction, where one may change to it: both have the same
    number of points, which lie beside each other."""
    right: int | None = None
    signal: int | None = None  # Index of the group of signals at its end, where one must stop unless it is green
    in_junction: bool = False  # Whether it crosses a junction: nobody may stop on it
    longest_m: float = float("inf")  # Longer vehicles may not use it: turning, they would need more room than there is


@dataclass(frozen=True, eq=False)
class SignalPlan:
    """Fixed-time signals: every group has one green a cycle."""

    cycle_s: float
    green_from_s: Float64  # (G,) when in the cycle a group's green begins, from 0 to below the cycle
    green_s: Float64  # (G,) how long it lasts; infinite: always
    yellow_s: float = 3.0

    @property
    def num_groups(self) -> int:
        """How many groups there are."""
        return len(self.green_from_s)

    def is_green(self, time_s: float) -> Bool:
        """Return of every group (G,) whether it is green."""
        return np.asarray((time_s - self.green_from_s) % self.cycle_s < self.green_s)

    def is_yellow(self, time_s: float) -> Bool:
        """Return of every group (G,) whether it has just been green."""
        since: Array = (time_s - self.green_from_s) % self.cycle_s
        return np.asarray((since >= self.green_s) & (since < self.green_s + self.yellow_s))


@dataclass(frozen=True, eq=False)
class Parking:
    """A place beside the road where a vehicle may stand."""

    position_m: tuple[float, float, float]
    yaw_rad: float
    length_m: float


@dataclass(frozen=True, eq=False)
class Polygon:
    """An outline in the ground plane, counter-clockwise, not closed, without holes."""

    kind: Literal["road", "sidewalk"]
    points_m: Float64  # (P, 2) x, y in the world


@dataclass(frozen=True, eq=False)
class CityMap:
    """A closed network: whoever drives on never comes to an end."""

    name: str
    lanes: tuple[Lane, ...]
    signals: SignalPlan
    polygons: tuple[Polygon, ...]  # Roads and sidewalks: the region of interest. May overlap.
    parkings: tuple[Parking, ...]
    street_lamps_m: Float64  # (L, 3) where street lamps shine from


@dataclass(frozen=True, eq=False)
class Draft:
    """One lane; other lanes are named by their keys."""

    key: Hashable
    points_m: Float64  # (P, 3)
    kind: LaneKind
    width_m: float
    speed_mps: float
    successors: tuple[Hashable, ...]
    left: Hashable | None = None
    right: Hashable | None = None
    signal: int | None = None
    in_junction: bool = False
    longest_m: float = float("inf")


def join_points(drafts: list[Draft]) -> tuple[Lane, ...]:
    """Number the lanes in their order. Raises KeyError where a lane names one that isn't there."""
    index = {draft.key: i for i, draft in enumerate(drafts)}
    return tuple(
        Lane(d.points_m, d.width_m, d.speed_mps, d.kind, tuple(index[key] for key in d.successors),
             None if d.left is None else index[d.left], None if d.right is None else index[d.right],
             d.signal, d.in_junction, d.longest_m)
        for d in drafts
    )  # fmt: skip


STEP_M = 1.0  # Points are at most so far apart
TURN_RAD = 0.08  # The heading changes by at most so much from one piece between two points to the next


def round_corners(corners_m: Float64, radii_m: list[float]) -> Float64:
    """Follow a polyline (K, 2) whose K - 2 inner corners are rounded by arcs of these radii; returns points (P, 2).
    Raises ValueError where a straight is too short for the arcs at its ends.
    """
    start, pieces = corners_m[0], [corners_m[:1]]
    for a, b, c, radius in zip(corners_m[:-2], corners_m[1:-1], corners_m[2:], radii_m, strict=True):
        u, v = _unit(b - a), _unit(c - b)
        turn = float(np.arctan2(u[0] * v[1] - u[1] * v[0], u[0] * v[0] + u[1] * v[1]))
        reach = radius * np.tan(abs(turn) / 2)
        pieces += [_line(start, b - reach * u), _arc(b - reach * u, u, radius, turn)]
        if np.dot(b - reach * u - start, u) < -1e-9:
            raise ValueError(f"no room for an arc of {radius:g} m before {b}")
        start = b + reach * v
    if np.dot(corners_m[-1] - start, _unit(corners_m[-1] - corners_m[-2])) < -1e-9:
        raise ValueError(f"no room for an arc before {corners_m[-1]}")
    return np.concatenate([*pieces, _line(start, corners_m[-1])])


def straight(start_m: Float64, end_m: Float64) -> Float64:
    """Points (P, 2) from start to end."""
    return np.concatenate([start_m[None], _line(start_m, end_m)])


def lift(points_m: Float64, z_m: float | Float64) -> Float64:
    """Give points (P, 2) a height: (P, 3)."""
    return np.column_stack([points_m, np.broadcast_to(np.asarray(z_m, np.float64), len(points_m))])


def sparse(points_m: Float64) -> Float64:
    """Drop points (P, 2) of an open line that lie on the straight between their neighbors."""
    before, after = points_m[1:-1] - points_m[:-2], points_m[2:] - points_m[1:-1]
    bend = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
    return np.asarray(points_m[np.concatenate([[True], bend > 1e-6, [True]])])


def length(points_m: Float64) -> float:
    """How long a line (P, D) is."""
    steps = np.diff(points_m, axis=0)
    return float(np.sqrt((steps * steps).sum(axis=1)).sum())


def _line(start: Float64, end: Float64) -> Float64:
    """Points after the start; none where there is no way."""
    way = end - start
    num = int(np.ceil(np.sqrt((way * way).sum()) / STEP_M - 1e-9))
    return np.asarray(start + way * (np.arange(1, num + 1) / max(num, 1))[:, None])


def _arc(start: Float64, ahead: Float64, radius: float, turn: float) -> Float64:
    """Points after the start of an arc that turns left by `turn` (right where it is negative)."""
    left = np.array([-ahead[1], ahead[0]]) * np.sign(turn)
    num = int(np.ceil(max(abs(turn) * radius / STEP_M, abs(turn) / TURN_RAD) - 1e-9))
    angle = (np.arange(1, num + 1) * (abs(turn) / max(num, 1)))[:, None]
    return np.asarray(start + radius * (np.sin(angle) * ahead + (1 - np.cos(angle)) * left))


def _unit(vector: Float64) -> Float64:
    return np.asarray(vector / np.sqrt((vector * vector).sum()))


GROUND_Z_M = -0.02  # Height of the meadow all around, just below roads
Kind: TypeAlias = Literal[
    "building", "tree", "bush", "lamp_post", "signal", "sign", "bench", "bin", "hydrant", "barrier", "gantry", "fence"
]


@dataclass(frozen=True, eq=False)
class Patch:
    """A flat piece of ground: a road, a sidewalk, a marking."""

    material: str  # Name in `MATERIALS`
    points_m: Float64  # (P, 2) outline in the world, counter-clockwise, not closed, without holes; may be concave
    z_m: float  # Its height; where it is above the ground and has a kerb, its sides go down to 0
    has_kerb: bool = False
    shade: float = 1.0  # Factor on the material's usual color


@dataclass(frozen=True)
class Placement:
    """One thing that stands."""

    kind: Kind
    position_m: tuple[float, float, float]  # The middle of its foot
    yaw_rad: float  # Where its front looks; along a barrier or fence
    size_lwh_m: tuple[float, float, float]
    """Length along its front's direction, width, height; a tree's crown is as wide as it is.

    A lamp post's length is the reach of its arm from the foot, a barrier's or fence's how far it goes on both sides of
    its foot together; a gantry spans the road by its width.
    """
    variant: int = 0  # Seed of its looks
    signal: int | None = None
    """Group of signals that a signal shows: its lamps are 3 * group + 0 red, 1 yellow, 2 green."""


@dataclass(frozen=True, eq=False)
class Layout:
    """A whole world."""

    map: CityMap
    patches: tuple[Patch, ...]
    placements: tuple[Placement, ...]
