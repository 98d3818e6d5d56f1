"""Everybody in the world and how they move, the same for the same layout, parameters and seed."""

from copy import copy
from typing import Final

import numpy as np

from fbench.datasets.city.actor import Actor, Body
from fbench.datasets.city.bodies.make import make_body
from fbench.datasets.city.motion import Motion
from fbench.datasets.city.traffic.ego import best_ego, sizes_of
from fbench.datasets.city.traffic.network import KINDS, Network, network_of
from fbench.datasets.city.traffic.params import TrafficParams
from fbench.datasets.city.traffic.placing import parked, placed
from fbench.datasets.city.traffic.played import PlayedMotion, step_of
from fbench.datasets.city.traffic.state import CHANGE, EMERGENCY, State
from fbench.datasets.city.traffic.step import advance, decide
from fbench.datasets.city.world.city_map import CityMap
from fbench.datasets.city.world.layout import Layout
from fbench.replay.arrays import Array
from fbench.replay.draws import generator
from fbench.replay.errors import ConfigError

__all__ = ["Traffic", "TrafficParams"]

STEP_S: Final = 0.1
_WARM_UP_STEPS: Final = 450
"""Steps before the log begins, so that queues and gaps are as they always are."""
_WALKERS: Final = 24
"""Different pedestrians in a world: each has the meshes of a whole gait."""
_EGO_LENGTH_M: Final = (4.3, 4.7)


class Traffic:
    """Simulates everybody.

    Raises:
        ConfigError: where the map has no room for a car.
    """

    def __init__(self, layout: Layout, params: TrafficParams, seed: int) -> None:
        self._signals = layout.map.signals
        self._net = network_of(layout.map)
        self._step, self._steps = -_WARM_UP_STEPS, list[State]()
        bodies, state = placed(self._net, _bodies(self._net, params, seed), params.speed_spread, seed)
        if not any(body.label == "car" for body in bodies):
            raise ConfigError(f"traffic: no car found room on map {layout.map.name!r}; raise vehicles_per_km")
        self._state, self._sizes = state, sizes_of(state)
        while self._step < 0:
            self._advance()
        bodies = self._choose_ego(bodies, seed)
        standing, self._parked = _parked(layout.map, params, seed)
        self.actors: tuple[Actor, ...] = (*(Actor(body) for body in bodies), *standing)
        """The ego car, other moving vehicles, bicycles, pedestrians, parked vehicles."""
        self._begin = _copy(self._state)

    def rewound(self) -> "Traffic":
        """Return the same traffic as it was at the beginning; this one stays as it is."""
        other = copy(self)
        other._state, other._step, other._steps = _copy(self._begin), 0, []
        return other

    @property
    def num_emergencies(self) -> int:
        """How often a moving body was stopped at once lest it touch another."""
        return int(self._state.counters[EMERGENCY])

    @property
    def num_lane_changes(self) -> int:
        """How often somebody has changed lanes."""
        return int(self._state.counters[CHANGE])

    def motion(self, from_s: float, to_s: float) -> Motion:
        """Simulate up to `to_s` and return what happens from `from_s` on, which never goes back.

        Raises:
            ConfigError: where `from_s` is negative, after `to_s`, or before that of an earlier call.
        """
        first, last = step_of(from_s, STEP_S), step_of(to_s, STEP_S)
        oldest = self._step - len(self._steps)
        if not 0 <= from_s <= to_s or first < oldest:
            raise ConfigError(
                f"traffic: expected times from {oldest * STEP_S:g} s on, ascending, got {from_s:g} to {to_s:g} s"
            )
        while self._step <= last:
            state = self._advance()
            if self._step > first:
                self._steps.append(state)
        self._steps = self._steps[len(self._steps) - (self._step - first) :]
        kept = tuple(self._steps[: last - first + 1])
        return PlayedMotion(self._net, self._signals, kept, first, STEP_S, from_s, to_s, self._parked)

    def _advance(self) -> State:
        """Do one step; return what was decided for it."""
        decide(self._net, self._state, self._sizes, self._step, STEP_S)
        decided = self._state._replace(movers=self._state.movers.copy(), way=self._state.way.copy())
        advance(self._net, self._state, STEP_S)
        self._step += 1
        return decided

    def _choose_ego(self, bodies: list[Body], seed: int) -> list[Body]:
        """Put one car first, with the ego's body."""
        cars = np.array([i for i, body in enumerate(bodies) if body.label == "car"], np.int64)
        ego = best_ego(self._net, self._state, cars, self._step, STEP_S)
        order = np.array([ego, *(i for i in range(len(bodies)) if i != ego)])
        s = self._state
        self._state = State(s.movers[order], s.way[order], s.choices[order], np.zeros_like(s.counters))
        body = _ego_body(seed)
        self._state.movers["length_m"][0], self._state.movers["width_m"][0] = body.size_lwh_m[:2]
        self._sizes = sizes_of(self._state)
        return [body, *(bodies[i] for i in order[1:])]


def _copy(state: State) -> State:
    return State(*(array.copy() for array in state))


def _bodies(net: Network, params: TrafficParams, seed: int) -> list[Body]:
    """Motor vehicles, bicycles, pedestrians; at least one car."""
    km = {
        kind: float(net.lanes["length_m"][(net.lanes["kind"] == number) & _outside(net)].sum()) / 1000
        for kind, number in KINDS.items()
    }
    draw = generator(seed, "traffic", "kinds")
    names = sorted(params.mix)
    shares = np.array([params.mix[name] for name in names])
    num = max(round(params.vehicles_per_km * km["drive"]), 1)
    kinds = ["car", *(names[k] for k in draw.choice(len(names), num - 1, p=shares / shares.sum()))]
    kinds += ["bicycle"] * round(params.bicycles_per_km * km["bike"])
    kinds += ["pedestrian"] * round(params.pedestrians_per_km * km["walk"])
    walkers = [_body("pedestrian", params.longest_m, seed, i) for i in range(min(_WALKERS, kinds.count("pedestrian")))]
    return [
        walkers[i % _WALKERS] if kind == "pedestrian" else _body(kind, params.longest_m, seed, i)
        for i, kind in enumerate(kinds)
    ]


def _body(kind: str, longest_m: float, seed: int, i: int) -> Body:
    """Draw a body that isn't too long.

    Raises:
        ConfigError: where bodies of this kind always are.
    """
    for k in range(50):
        body = make_body(kind, generator(seed, "traffic", "body", i, k))
        if body.size_lwh_m[0] <= longest_m:
            return body
    raise ConfigError(f"traffic: each {kind} is longer than {longest_m:g} m; raise longest_m or change mix")


def _outside(net: Network) -> Array:
    """Lanes (L,) that are no gate as a whole."""
    whole = np.zeros(len(net.lanes), bool)
    for lane in range(len(whole)):
        gates = net.gates[net.lanes["gate_from"][lane] : net.lanes["gate_to"][lane]]
        whole[lane] = bool((gates["to_m"] - gates["from_m"] >= net.lanes["length_m"][lane] - 1e-9).any())
    return ~whole


def _parked(city_map: CityMap, params: TrafficParams, seed: int) -> tuple[list[Actor], Array]:
    draw = generator(seed, "traffic", "parked")
    rows, bodies = [], []
    for row, place in enumerate(city_map.parkings):
        kind = "van" if draw.random() < 0.1 else "car"
        if draw.random() < params.parked_share:
            body = make_body(kind, generator(seed, "traffic", "parked body", row))
            if body.size_lwh_m[0] < place.length_m - 0.4:
                rows.append(row)
                bodies.append(body)
    return parked(city_map, bodies, np.array(rows, np.int64))


def _ego_body(seed: int) -> Body:
    """A car of about 4.5 m."""
    low, high = _EGO_LENGTH_M
    for k in range(100):
        body = make_body("car", generator(seed, "traffic", "ego body", k))
        if low <= body.size_lwh_m[0] <= high:
            return body
    raise ConfigError(f"traffic: no car of {low:g} to {high:g} m among 100")
