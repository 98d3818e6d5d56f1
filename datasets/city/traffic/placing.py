"""Placing of everybody at the beginning, and what drivers, riders and walkers are like."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Final, Literal, NamedTuple

import numpy as np

from fbench.datasets.city.mesh import Body
from fbench.datasets.city.spec import WorldName
from fbench.datasets.city.traffic.network import BIKE, DRIVE, HERE, MOVER, NUM_CHOICES, WALK, WINDOW, Network, State
from fbench.datasets.city.traffic.path_kernel import extend
from fbench.replay.conditions.generators import generator
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Array


@dataclass(frozen=True)
class Driver:
    """What one mover is like: fields of `MOVER` of the same names, which says what they mean."""

    kind: int
    factor: float
    fastest_mps: float
    headway_s: float
    standing_gap_m: float
    acceleration_mps2: float
    braking_mps2: float
    margin_m: float
    keeps_right: bool = False
    cycle_m: float = 0.0


@dataclass(frozen=True)
class Habits:
    """Ranges from which a driver of one kind is drawn."""

    fastest_mps: tuple[float, float]
    headway_s: tuple[float, float]
    acceleration_mps2: tuple[float, float]
    braking_mps2: float
    standing_gap_m: float
    margin_m: float


HABITS: Final[Mapping[str, Habits]] = {
    "car": Habits((27.0, 38.0), (1.0, 1.6), (1.4, 2.0), 2.0, 2.0, 1.0),
    "van": Habits((25.0, 34.0), (1.1, 1.7), (1.0, 1.4), 2.0, 2.0, 1.0),
    "truck": Habits((22.2, 24.7), (1.4, 2.0), (0.6, 0.9), 1.6, 2.5, 1.2),
    "bus": Habits((24.0, 27.8), (1.4, 2.0), (0.7, 1.0), 1.6, 2.5, 1.2),
    "motorcycle": Habits((28.0, 40.0), (0.9, 1.5), (1.6, 2.4), 2.2, 1.8, 1.0),
    "bicycle": Habits((4.0, 6.0), (0.8, 1.2), (0.8, 1.2), 1.5, 1.0, 0.5),
    "pedestrian": Habits((1.0, 1.6), (0.4, 0.7), (0.8, 1.2), 1.2, 0.35, 0.15),
}
"""Around the typical values of Treiber, Kesting, "Traffic Flow Dynamics" (2013), table 11.2: T 1 s, s0 2 m, a 1 m/s^2,
b 1.5 m/s^2, with longer headways and slower starts of heavy vehicles (T 1.5 s and more). Bicycles and people on foot
follow the same rule with speeds typical of them (people: 1 to 1.6 m/s)."""
_STRIDE_M, _TALL_M, _PEDALS_M = 1.4, 1.75, 4.5
"""A cycle of two steps of a person this tall; what a turn of the pedals goes."""


def draw_driver(label: str, height_m: float, spread: float, draw: np.random.Generator) -> Driver:
    """Draw whoever moves a body."""
    habits = HABITS[label]
    walks, rides = label == "pedestrian", label == "bicycle"
    factor = float(np.clip(draw.normal(1.0, spread), 0.8, 1.2))
    return Driver(
        WALK if walks else BIKE if rides else DRIVE,
        1.0 if walks or rides else factor,
        float(draw.uniform(*habits.fastest_mps)), float(draw.uniform(*habits.headway_s)),
        habits.standing_gap_m, float(draw.uniform(*habits.acceleration_mps2)), habits.braking_mps2, habits.margin_m,
        label in ("truck", "bus"),
        _STRIDE_M * height_m / _TALL_M if walks else _PEDALS_M if rides else 0.0,
    )  # fmt: skip


_TRIES, _LEAST_LANE_M = 300, 6.0
_START = 0.7  # Share of the desired speed at first
_FREE = {DRIVE: (6.0, 0.8), BIKE: (3.0, 0.5), WALK: (1.0, 0.5)}
"""Least gap to others: in meters, and in seconds of one's speed on top."""
_LEAVING_MPS2 = 1.5  # One can brake so gently and stop at the end of the lane


class Place(NamedTuple):
    """A mover's beginning."""

    lane: int
    at_m: float
    speed_mps: float


def place_movers(net: Network, bodies: list[Body], spread: float, seed: int) -> tuple[list[Body], State]:
    """Place bodies on lanes of their kind, the longest first; who finds no place stays away. Returns those who have a
    place, in their order, and their state.
    """
    drivers = [draw_driver(body.label, body.size_lwh_m[2], spread, generator(seed, "traffic", "driver", i))
               for i, body in enumerate(bodies)]  # fmt: skip
    draw = generator(seed, "traffic", "places")
    found: dict[int, Place] = {}
    taken: dict[int, list[tuple[float, float]]] = {}
    for i in sorted(range(len(bodies)), key=lambda k: (-bodies[k].size_lwh_m[0], k)):
        place = _place(net, bodies[i].size_lwh_m[0], drivers[i], taken, draw)
        if place is not None:
            found[i] = place
            taken.setdefault(place.lane, []).append((place.at_m, bodies[i].size_lwh_m[0]))
    keep = sorted(found)
    state = _state(net, [bodies[i] for i in keep], [drivers[i] for i in keep], [found[i] for i in keep], seed)
    return [bodies[i] for i in keep], state


def _place(
    net: Network,
    length_m: float,
    driver: Driver,
    taken: dict[int, list[tuple[float, float]]],
    draw: np.random.Generator,
) -> Place | None:
    lanes = net.lanes
    usable = (lanes["kind"] == driver.kind) & (lanes["longest_m"] >= length_m) & (lanes["length_m"] >= _LEAST_LANE_M)
    if driver.keeps_right:
        usable &= lanes["right"] < 0
    room = np.where(usable, np.maximum(lanes["length_m"] - length_m - 2.0, 0.0), 0.0)
    if not room.sum():
        return None
    edges, (free_m, free_s) = np.cumsum(room), _FREE[driver.kind]
    for _ in range(_TRIES):
        lane = int(np.searchsorted(edges, draw.random() * edges[-1], side="right"))
        at = 1.0 + length_m / 2 + float(draw.random()) * float(room[lane])
        speed = _START * min(driver.fastest_mps, float(lanes["speed_mps"][lane]) * driver.factor)
        after = _after(net, lane)
        if (lanes["gate_to"][after] > lanes["gate_from"][after]).any():  # one may have to stop at the lane's end
            left_m = lanes["length_m"][lane] - at - length_m / 2
            speed = min(speed, float(np.sqrt(2 * _LEAVING_MPS2 * left_m)))
        apart = [abs(at - other) - (length_m + long) / 2 for other, long in taken.get(lane, [])]
        gates = net.gates[lanes["gate_from"][lane] : lanes["gate_to"][lane]]
        in_gate = (gates["from_m"] < at + length_m / 2 + 2.0) & (gates["to_m"] > at - length_m / 2 - 2.0)
        if min(apart, default=np.inf) >= free_m + free_s * speed and not in_gate.any():
            return Place(lane, at, speed)
    return None


def _after(net: Network, lane: int) -> Array:
    """Successors of a lane."""
    return np.asarray(net.nexts["lane"][net.lanes["next_from"][lane] : net.lanes["next_to"][lane]])


def _state(net: Network, bodies: list[Body], drivers: list[Driver], places: list[Place], seed: int) -> State:
    movers = np.zeros(len(bodies), MOVER)
    draws = [generator(seed, "traffic", "ways", i) for i in range(len(bodies))]
    for entry in fields(Driver):
        movers[entry.name] = [getattr(driver, entry.name) for driver in drivers]
    movers["length_m"] = [body.size_lwh_m[0] for body in bodies]
    movers["width_m"] = [body.size_lwh_m[1] for body in bodies]
    movers["at_m"], movers["speed_mps"] = [p.at_m for p in places], [p.speed_mps for p in places]
    movers["base_m"] = [draw.uniform(0, 100) for draw in draws]
    movers["right_to_m"] = movers["base_m"] + movers["at_m"] + movers["length_m"] / 2
    movers["side_from_m"], movers["side_for_m"] = -1e9, 1.0
    choices = np.array([draw.random(NUM_CHOICES) for draw in draws]).reshape(len(bodies), NUM_CHOICES)
    # Lanes behind each mover are the first that lead there, -1 where none does.
    before = np.full(len(net.lanes), -1)
    for lane in range(len(before) - 1, -1, -1):
        before[_after(net, lane)] = lane
    ways = np.full((len(places), WINDOW), -1, np.int64)
    for i, place in enumerate(places):
        ways[i, HERE] = place.lane
        for k in range(HERE, 0, -1):
            ways[i, k - 1] = before[ways[i, k]] if ways[i, k] >= 0 else -1
    extend(net.lanes, net.nexts, movers, ways, choices)
    return State(movers, ways, choices, np.zeros(2, np.int64))


_MOTOR = ("car", "van", "truck", "bus", "motorcycle")
URBAN_MIX = MappingProxyType(dict(zip(_MOTOR, (0.78, 0.1, 0.04, 0.04, 0.04), strict=True)))
HIGHWAY_MIX = MappingProxyType(dict(zip(_MOTOR, (0.72, 0.09, 0.14, 0.02, 0.03), strict=True)))
"""Shares of moving vehicles: passenger cars dominate, on motorways one vehicle in seven is a truck."""


@dataclass(frozen=True)
class TrafficParams:
    """Densities and kinds. Raises ConfigError where a number is negative or above 1000, or a share above 1."""

    vehicles_per_km: float = 16.0
    """Moving motor vehicles on each km of drive lane outside junctions."""
    bicycles_per_km: float = 7.0
    """On each km of bike lane."""
    pedestrians_per_km: float = 5.5
    """On each km of walk lane."""
    parked_share: float = 0.2
    """Of places to park."""
    mix: Mapping[str, float] = field(default_factory=lambda: URBAN_MIX)
    """How often a moving vehicle is of which kind."""
    longest_m: float = 12.2
    """Longer bodies are drawn anew."""
    speed_spread: float = 0.08
    """Standard deviation of the drivers' factor on speed limits."""

    def __post_init__(self) -> None:
        for name in ("vehicles_per_km", "bicycles_per_km", "pedestrians_per_km", "parked_share", "speed_spread"):
            value, most = getattr(self, name), 1 if name == "parked_share" else 1000
            if not 0 <= value <= most:
                raise ConfigError(f"traffic {name}: expected 0 to {most}, got {value}")

    @classmethod
    def of(cls, world: WorldName, density: Literal["normal", "dense"] = "normal") -> "TrafficParams":
        """Typical traffic of a world."""
        dense = density == "dense"
        if world == "highway":
            return cls(14.0 if dense else 7.0, mix=HIGHWAY_MIX, longest_m=20.0, speed_spread=0.1)
        return cls(29.0, 14.0, 11.0, 0.3) if dense else cls()
