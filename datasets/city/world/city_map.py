"""What a map holds: lanes as a graph, signals, regions, lamps and places for parked cars."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

from fbench.replay.arrays import Array, Bool, Float64

LaneKind: TypeAlias = Literal["drive", "bike", "walk"]


@dataclass(frozen=True, eq=False)
class Lane:
    """One lane between two nodes of the graph, in its direction of travel."""

    points_m: Float64
    """(P, 3) centre line in the world, from the first point to the last, at most 1 m apart; smooth, and continued
    smoothly by the first point of each successor, which is equal to its last."""
    width_m: float
    speed_mps: float
    """How fast one may go."""
    kind: LaneKind
    successors: tuple[int, ...]
    """Indices of the lanes that go on from its end; never empty: networks are closed."""
    left: int | None = None
    """Index of the parallel lane on the left with the same direction, where one may change to it: both have the same
    number of points, which lie beside each other."""
    right: int | None = None
    signal: int | None = None
    """Index of the group of signals at its end, where one must stop unless it is green."""
    in_junction: bool = False
    """Whether it crosses a junction: nobody may stop on it."""
    longest_m: float = float("inf")
    """Longer vehicles may not use it: turning, they would need more room than there is."""


@dataclass(frozen=True, eq=False)
class SignalPlan:
    """Fixed-time signals: every group has one green a cycle."""

    cycle_s: float
    green_from_s: Float64
    """(G,) when in the cycle a group's green begins, from 0 to below the cycle."""
    green_s: Float64
    """(G,) how long it lasts; infinite: always."""
    yellow_s: float = 3.0

    @property
    def num_groups(self) -> int:
        """How many groups there are."""
        return len(self.green_from_s)

    def is_green(self, time_s: float) -> Bool:
        """Tell of every group (G,) whether it is green."""
        since: Array = (time_s - self.green_from_s) % self.cycle_s
        green: Bool = since < self.green_s
        return green

    def is_yellow(self, time_s: float) -> Bool:
        """Tell of every group (G,) whether it has just been green."""
        since: Array = (time_s - self.green_from_s) % self.cycle_s
        yellow: Bool = (since >= self.green_s) & (since < self.green_s + self.yellow_s)
        return yellow


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
    points_m: Float64
    """(P, 2) x, y in the world."""


@dataclass(frozen=True, eq=False)
class CityMap:
    """A closed network: whoever drives on never comes to an end."""

    name: str
    lanes: tuple[Lane, ...]
    signals: SignalPlan
    polygons: tuple[Polygon, ...]
    """Roads and sidewalks: the region of interest. May overlap."""
    parkings: tuple[Parking, ...]
    street_lamps_m: Float64
    """(L, 3) where street lamps shine from."""
