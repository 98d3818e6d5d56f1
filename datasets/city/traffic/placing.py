"""Placing of everybody at the beginning, and what drivers, riders and walkers are like."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final, Literal

import numpy as np

from fbench.datasets.city.mesh import Body
from fbench.datasets.city.spec import WorldName
from fbench.datasets.city.traffic.network import BIKE, DRIVE, HERE, MOVER, NUM_CHOICES, WALK, WINDOW, Network, State
from fbench.datasets.city.traffic.path_kernel import extend
from fbench.replay.conditions.generators import generator
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Array


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


def draw_driver(me: np.void, body: Body, spread: float, draw: np.random.Generator) -> None:
    """Draw whoever moves a body: what a mover of `MOVER` is like."""
    habits, walks, rides = HABITS[body.label], body.label == "pedestrian", body.label == "bicycle"
    me["length_m"], me["width_m"], height_m = body.size_lwh_m
    factor = float(np.clip(draw.normal(1.0, spread), 0.8, 1.2))
    me["kind"], me["factor"] = (WALK, 1.0) if walks else (BIKE, 1.0) if rides else (DRIVE, factor)
    for name in ("fastest_mps", "headway_s", "acceleration_mps2"):
        me[name] = draw.uniform(*getattr(habits, name))
    for name in ("standing_gap_m", "braking_mps2", "margin_m"):
        me[name] = getattr(habits, name)
    me["keeps_right"] = body.label in ("truck", "bus")
    me["cycle_m"] = _STRIDE_M * height_m / _TALL_M if walks else _PEDALS_M if rides else 0.0


_TRIES, _LEAST_LANE_M = 300, 6.0
_START = 0.7  # Share of the desired speed at first
_FREE = {DRIVE: (6.0, 0.8), BIKE: (3.0, 0.5), WALK: (1.0, 0.5)}
"""Least gap to others: in meters, and in seconds of one's speed on top."""
_LEAVING_MPS2 = 1.5  # One can brake so gently and stop at the end of the lane


def place_movers(net: Network, bodies: list[Body], spread: float, seed: int) -> tuple[list[Body], State]:
    """Place bodies on lanes of their kind, the longest first; who finds no place stays away. Returns those who have a
    place, in their order, and their state.
    """
    movers, on = np.zeros(len(bodies), MOVER), np.full(len(bodies), -1)
    for i, body in enumerate(bodies):
        draw_driver(movers[i], body, spread, generator(seed, "traffic", "driver", i))
    draw, taken = generator(seed, "traffic", "places"), defaultdict[int, list[tuple[float, float]]](list)
    for i in sorted(range(len(bodies)), key=lambda k: (-bodies[k].size_lwh_m[0], k)):
        on[i] = _place(net, movers[i], taken, draw)
    keep = np.flatnonzero(on >= 0)
    movers, on = movers[keep], on[keep]
    draws = [generator(seed, "traffic", "ways", i) for i in range(len(keep))]
    movers["base_m"] = [draw.uniform(0, 100) for draw in draws]
    movers["right_to_m"] = movers["base_m"] + movers["at_m"] + movers["length_m"] / 2
    movers["side_from_m"], movers["side_for_m"] = -1e9, 1.0
    choices = np.array([draw.random(NUM_CHOICES) for draw in draws]).reshape(len(keep), NUM_CHOICES)
    # Lanes behind each mover are the first that lead there, -1 where none does.
    before = np.full(len(net.lanes), -1)
    for lane in range(len(before) - 1, -1, -1):
        before[_after(net, lane)] = lane
    ways = np.full((len(keep), WINDOW), -1, np.int64)
    ways[:, HERE] = on
    for k in range(HERE, 0, -1):
        ways[:, k - 1] = np.where(ways[:, k] >= 0, before[ways[:, k]], -1)
    extend(net.lanes, net.nexts, movers, ways, choices)
    return [bodies[i] for i in keep], State(movers, ways, choices, np.zeros(2, np.int64))


def _place(net: Network, me: np.void, taken: dict[int, list[tuple[float, float]]], draw: np.random.Generator) -> int:
    """Set where a mover begins, and how fast; return its lane, -1 for none. `taken` are places and lengths by lane."""
    lanes, length_m = net.lanes, float(me["length_m"])
    usable = (lanes["kind"] == me["kind"]) & (lanes["longest_m"] >= length_m) & (lanes["length_m"] >= _LEAST_LANE_M)
    if me["keeps_right"]:
        usable &= lanes["right"] < 0
    room = np.where(usable, np.maximum(lanes["length_m"] - length_m - 2.0, 0.0), 0.0)
    if not room.sum():
        return -1
    edges, (free_m, free_s) = np.cumsum(room), _FREE[int(me["kind"])]
    for _ in range(_TRIES):
        lane = int(np.searchsorted(edges, draw.random() * edges[-1], side="right"))
        at = 1.0 + length_m / 2 + float(draw.random()) * float(room[lane])
        speed = _START * float(min(me["fastest_mps"], lanes["speed_mps"][lane] * me["factor"]))
        after = _after(net, lane)
        if (lanes["gate_to"][after] > lanes["gate_from"][after]).any():  # one may have to stop at the lane's end
            left_m = lanes["length_m"][lane] - at - length_m / 2
            speed = min(speed, float(np.sqrt(2 * _LEAVING_MPS2 * left_m)))
        apart = [abs(at - other) - (length_m + long) / 2 for other, long in taken[lane]]
        gates = net.gates[lanes["gate_from"][lane] : lanes["gate_to"][lane]]
        in_gate = (gates["from_m"] < at + length_m / 2 + 2.0) & (gates["to_m"] > at - length_m / 2 - 2.0)
        if min(apart, default=np.inf) >= free_m + free_s * speed and not in_gate.any():
            me["at_m"], me["speed_mps"] = at, speed
            taken[lane].append((at, length_m))
            return lane
    return -1


def _after(net: Network, lane: int) -> Array:
    """Successors of a lane."""
    return np.asarray(net.nexts["lane"][net.lanes["next_from"][lane] : net.lanes["next_to"][lane]])


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
