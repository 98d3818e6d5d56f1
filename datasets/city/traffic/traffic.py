"""Everybody in the world and how they move, the same for the same layout, parameters and seed."""

from copy import copy
from dataclasses import dataclass
from typing import Final

import numpy as np

from fbench.datasets.city.bodies.make import make_body
from fbench.datasets.city.instant import BodyStates
from fbench.datasets.city.mesh import Actor, Body
from fbench.datasets.city.traffic.follow_kernel import accelerate, change_lanes
from fbench.datasets.city.traffic.gate_kernel import asking_movers, give_rights, holders, lights_at, take_back
from fbench.datasets.city.traffic.network import CHANGE, DRIVE, EMERGENCY, HERE, KINDS, Network, State, network_of
from fbench.datasets.city.traffic.occupancy_kernel import leader, left_sides, near_pairs, occupancy
from fbench.datasets.city.traffic.path_kernel import MARGIN_M, extend, move, poses, stop_before_touching
from fbench.datasets.city.traffic.placing import TrafficParams, place_movers
from fbench.datasets.city.world.city_map import CityMap, Layout, SignalPlan
from fbench.replay.conditions.generators import generator
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Array, Float64

STEP_S: Final = 0.1
_WARM_UP_STEPS: Final = 450  # Steps before the log begins, so that queues and gaps are as they always are
_WALKERS: Final = 24  # Different pedestrians in a world: each has the meshes of a whole gait
_EGO_LENGTH_M: Final = (4.3, 4.7)


def decide(net: Network, state: State, sizes: Float64, step: int) -> None:
    """Set what everybody does from step `step` to the next; `sizes` (N, 2) are lengths and widths."""
    taken = occupancy(net.path, net.lanes, state.movers, state.way)
    lights, roads = lights_at(net, step * STEP_S), net.roads
    num_changed = change_lanes(roads, net.gates, state.movers, state.way, taken, step)
    if num_changed:
        extend(net.lanes, net.nexts, state.movers, state.way, state.choices)
    take_back(net.lanes, lights, state.movers, state.way)
    held = holders(net.lanes, state.movers, state.way)
    asking = asking_movers(net.roads, net.gates, lights, state.movers, state.way, taken, STEP_S)
    give_rights(net.lanes, net.gates, net.conflicts, lights, state.movers, state.way, taken, held, asking)
    accelerate(roads, net.gates, lights, state.movers, state.way, taken)
    now, then = poses_of(net, state, 0.0), poses_of(net, state, STEP_S)
    pairs = near_pairs(now, then, sizes, MARGIN_M)
    state.counters[CHANGE] += num_changed
    state.counters[EMERGENCY] += stop_before_touching(state.movers, now, then, sizes, pairs)


def advance(net: Network, state: State) -> None:
    """Do what was decided."""
    move(net.lanes, state.movers, state.way, STEP_S)
    extend(net.lanes, net.nexts, state.movers, state.way, state.choices)


def poses_of(net: Network, state: State, since_s: float) -> Float64:
    """Poses (N, 9) of all movers, `since_s` after the step's beginning; see `poses`."""
    return poses(net.path, net.lanes, state.movers, state.way, since_s)


@dataclass(frozen=True, eq=False)
class Motion:
    """What everybody does in some steps; never changes, so threads can share it."""

    net: Network
    signals: SignalPlan
    states: tuple[State, ...]  # One for each step, as decided at its beginning
    first_step: int
    from_s: float
    to_s: float
    parked: Float64  # (K, 4) x, y, z, yaw

    def at(self, time_s: float) -> BodyStates:
        """Return the bodies at a time from `from_s` to `to_s`. Raises ConfigError at another time."""
        if not self.from_s - 1e-9 <= time_s <= self.to_s + 1e-9:
            raise ConfigError(f"motion: expected a time from {self.from_s:g} to {self.to_s:g} s, got {time_s:g} s")
        step = step_of(time_s)
        state = self.states[min(max(step - self.first_step, 0), len(self.states) - 1)]
        since = max(time_s - step * STEP_S, 0.0)
        moving, still, movers = poses_of(self.net, state, since), np.zeros(len(self.parked)), state.movers
        walks = movers["cycle_m"] > 0
        cycles = (movers["base_m"] + movers["at_m"] + moving[:, 8]) / np.where(walks, movers["cycle_m"], 1.0)
        phase = np.where(walks, cycles - np.floor(cycles), 0.0)
        green, yellow = self.signals.is_green(time_s), self.signals.is_yellow(time_s)
        return BodyStates(
            float(time_s),
            np.concatenate([moving[:, :3], self.parked[:, :3]]),
            np.concatenate([moving[:, 6], self.parked[:, 3]]),
            np.concatenate([moving[:, 3:6], np.zeros((len(self.parked), 3))]),
            np.concatenate([moving[:, 7], still]),
            np.concatenate([np.where(phase < 1.0, phase, 0.0), still]),
            np.concatenate([movers["braking"], still > 0]),
            np.column_stack([~green & ~yellow, yellow & ~green, green]).ravel(),
        )


def step_of(time_s: float) -> int:
    """The step in which a time is; borders belong to the step that begins there, give or take rounding."""
    return int(np.floor(time_s / STEP_S + 1e-9))


_TRIAL_S, _START_S, _EVERY = 10.0, 5.0, 5
"""How long the trial is, for how long one should not stop, and steps between looks around."""
_AHEAD_M, _BEHIND_M, _AT_ONCE_M = 50.0, 20.0, 40.0
"""Whom one sees: ahead, within 45 degrees on both sides, and behind; whom one must see at first."""
_ENOUGH = 5.0  # More company than this doesn't count
_MOVING_MPS = 2.0
_FREE_M = 1.5  # Room before and behind, so that its body may be longer
_LONGEST_M = 12.0


def best_ego(net: Network, state: State, cars: Array, step: int) -> int:
    """Choose among movers, after a trial of some seconds: who moves on, in company, and isn't far from the middle."""
    trial, sizes = _copy(state), sizes_of(state)
    motor = np.flatnonzero(state.movers["kind"] == DRIVE)
    here = poses_of(net, state, 0.0)
    company, speed, slowest = np.zeros(len(cars)), np.zeros(len(cars)), np.full(len(cars), np.inf)
    num = int(_TRIAL_S / STEP_S)
    for k in range(num):
        if k % _EVERY == 0:
            company += np.minimum(_company(poses_of(net, trial, 0.0), cars, motor), _ENOUGH) * _EVERY / num
        decide(net, trial, sizes, step + k)
        v = trial.movers["speed_mps"][cars]
        speed += v / num
        slowest = np.minimum(slowest, v) if k * STEP_S < _START_S else slowest
        advance(net, trial)
    limit = np.array([min(net.lanes["speed_mps"][state.way[i, HERE]], state.movers["fastest_mps"][i]) for i in cars])
    sees = _company(here, cars, motor, ahead_m=_AT_ONCE_M, behind_m=0.0) > 0
    score = company / _ENOUGH + np.minimum(speed / limit, 0.8) + 0.5 * sees + (slowest > _MOVING_MPS)
    middle = here[:, :2] - (here[:, :2].min(axis=0) + here[:, :2].max(axis=0)) / 2
    outward = np.abs(middle / np.maximum(np.abs(middle).max(axis=0), 1.0)).max(axis=1)  # 1 at the border
    score -= 1.5 * np.maximum(outward[cars] - 0.6, 0.0)
    return int(cars[np.argmax(np.where(_has_room(net, state, cars), score, -np.inf))])


def sizes_of(state: State) -> Float64:
    """Footprints (N, 2)."""
    return np.column_stack([state.movers["length_m"], state.movers["width_m"]])


def _company(
    at: Float64, cars: Array, others: Array, ahead_m: float = _AHEAD_M, behind_m: float = _BEHIND_M
) -> Float64:
    """How many of some others each car (K,) has before and behind it; `at` (N, 9) are poses."""
    apart = at[None, others, :2] - at[cars, None, :2]
    cos, sin = np.cos(at[cars, 6])[:, None], np.sin(at[cars, 6])[:, None]
    ahead, left = apart[..., 0] * cos + apart[..., 1] * sin, np.abs(apart[..., 1] * cos - apart[..., 0] * sin)
    far = np.sqrt(ahead * ahead + left * left)
    seen = ((far < ahead_m) & (left < ahead)) | ((far < behind_m) & (left < -ahead))
    return np.asarray(seen.sum(axis=1), np.float64)


def _has_room(net: Network, state: State, cars: Array) -> Array:
    """Which cars (K,) are not changing lanes and have nobody just before or behind them."""
    taken = occupancy(net.path, net.lanes, state.movers, state.way)
    sides, room = left_sides(state.movers), np.zeros(len(cars), bool)
    for row, i in enumerate(cars):
        ahead, _ = leader(net.roads, state.movers, state.way[i], taken, i, 50.0)
        same = taken.first[state.way[i, HERE]], taken.first[state.way[i, HERE] + 1]
        who, at = taken.who[slice(*same)], taken.at_m[slice(*same)]
        behind = at[(who != i) & (at <= state.movers["at_m"][i])]
        gap = state.movers["at_m"][i] - behind.max(initial=-np.inf) - _LONGEST_M
        room[row] = ahead > _FREE_M and gap > _FREE_M and sides[i] == 0
    return room


class Traffic:
    """Simulates everybody. Raises ConfigError where the map has no room for a car."""

    def __init__(self, layout: Layout, params: TrafficParams, seed: int) -> None:
        self._signals = layout.map.signals
        self._net = network_of(layout.map)
        self._step, self._steps = -_WARM_UP_STEPS, list[State]()
        bodies, state = place_movers(self._net, _bodies(self._net, params, seed), params.speed_spread, seed)
        if not any(body.label == "car" for body in bodies):
            raise ConfigError(f"traffic: no car found room on map {layout.map.name!r}; raise vehicles_per_km")
        self._state, self._sizes = state, sizes_of(state)
        while self._step < 0:
            self._advance()
        bodies = self._choose_ego(bodies, seed)
        parked, self._parked = _park_vehicles(layout.map, params, seed)
        self.actors: tuple[Actor, ...] = (*map(Actor, bodies), *(Actor(body, parked=True) for body in parked))
        """The ego car, other moving vehicles, bicycles, pedestrians, parked vehicles."""
        self._begin = _copy(self._state)

    def rewind(self) -> "Traffic":
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
        """Simulate up to `to_s` and return what happens from `from_s` on, which never goes back. Raises ConfigError
        where `from_s` is negative, after `to_s`, or before that of an earlier call.
        """
        first, last = step_of(from_s), step_of(to_s)
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
        return Motion(self._net, self._signals, kept, first, from_s, to_s, self._parked)

    def _advance(self) -> State:
        """Do one step; return what was decided for it."""
        decide(self._net, self._state, self._sizes, self._step)
        decided = self._state._replace(movers=self._state.movers.copy(), way=self._state.way.copy())
        advance(self._net, self._state)
        self._step += 1
        return decided

    def _choose_ego(self, bodies: list[Body], seed: int) -> list[Body]:
        """Put one car first, with the ego's body."""
        cars = np.array([i for i, body in enumerate(bodies) if body.label == "car"], np.int64)
        ego = best_ego(self._net, self._state, cars, self._step)
        order = np.array([ego, *(i for i in range(len(bodies)) if i != ego)])
        s = self._state
        self._state = State(s.movers[order], s.way[order], s.choices[order], np.zeros_like(s.counters))
        low, high = _EGO_LENGTH_M
        cars_drawn = (make_body("car", generator(seed, "traffic", "ego body", k)) for k in range(100))
        body = next((car for car in cars_drawn if low <= car.size_lwh_m[0] <= high), None)
        if body is None:
            raise ConfigError(f"traffic: no car of {low:g} to {high:g} m among 100")
        self._state.movers["length_m"][0], self._state.movers["width_m"][0] = body.size_lwh_m[:2]
        self._sizes = sizes_of(self._state)
        return [body, *(bodies[i] for i in order[1:])]


def _copy(state: State) -> State:
    return State(*(array.copy() for array in state))


def _bodies(net: Network, params: TrafficParams, seed: int) -> list[Body]:
    """Motor vehicles, bicycles, pedestrians; at least one car."""
    lanes, outside = net.lanes, np.ones(len(net.lanes), bool)
    for lane, (begin, end) in enumerate(zip(lanes["gate_from"], lanes["gate_to"], strict=True)):
        gates = net.gates[begin:end]  # of a lane that is a gate as a whole, one
        outside[lane] = not (gates["to_m"] - gates["from_m"] >= lanes["length_m"][lane] - 1e-9).any()
    km = {kind: float(lanes["length_m"][(lanes["kind"] == number) & outside].sum()) / 1000
          for kind, number in KINDS.items()}  # fmt: skip
    draw = generator(seed, "traffic", "kinds")
    names = sorted(params.mix)
    shares = np.array([params.mix[name] for name in names])
    num = max(round(params.vehicles_per_km * km["drive"]), 1)
    kinds = ["car", *(names[k] for k in draw.choice(len(names), num - 1, p=shares / shares.sum()))]
    kinds += ["bicycle"] * round(params.bicycles_per_km * km["bike"])
    kinds += ["pedestrian"] * round(params.pedestrians_per_km * km["walk"])
    num_walkers = min(_WALKERS, kinds.count("pedestrian"))
    walkers = [_body("pedestrian", params.longest_m, seed, i) for i in range(num_walkers)]
    return [walkers[i % _WALKERS] if kind == "pedestrian" else _body(kind, params.longest_m, seed, i)
            for i, kind in enumerate(kinds)]  # fmt: skip


def _body(kind: str, longest_m: float, seed: int, i: int) -> Body:
    """Draw a body that isn't too long. Raises ConfigError where bodies of this kind always are."""
    for k in range(50):
        body = make_body(kind, generator(seed, "traffic", "body", i, k))
        if body.size_lwh_m[0] <= longest_m:
            return body
    raise ConfigError(f"traffic: each {kind} is longer than {longest_m:g} m; raise longest_m or change mix")


def _park_vehicles(city_map: CityMap, params: TrafficParams, seed: int) -> tuple[list[Body], Float64]:
    """Bodies that stand in places to park, and their x, y, z, yaw (K, 4)."""
    draw, bodies, at = generator(seed, "traffic", "parked"), [], []
    for row, place in enumerate(city_map.parkings):
        kind = "van" if draw.random() < 0.1 else "car"
        if draw.random() < params.parked_share:
            body = make_body(kind, generator(seed, "traffic", "parked body", row))
            if body.size_lwh_m[0] < place.length_m - 0.4:
                bodies.append(body)
                at.append([*place.position_m, place.yaw_rad])
    return bodies, np.array(at, np.float64).reshape(-1, 4)
