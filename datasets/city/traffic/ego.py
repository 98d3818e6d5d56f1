"""Which car carries the sensors: one that drives, among others that it keeps in view."""

import numpy as np

from fbench.datasets.city.traffic.network import DRIVE, Network
from fbench.datasets.city.traffic.occupancy_kernel import leader, left_sides
from fbench.datasets.city.traffic.state import HERE, State
from fbench.datasets.city.traffic.step import advance, decide, occupied, poses_of
from fbench.replay.arrays import Array, Float64

_TRIAL_S, _START_S, _EVERY = 10.0, 5.0, 5
"""How long the trial is, for how long one should not stop, and steps between looks around."""
_AHEAD_M, _BEHIND_M, _AT_ONCE_M = 50.0, 20.0, 40.0
"""Whom one sees: ahead, within 45 degrees on both sides, and behind; whom one must see at first."""
_ENOUGH = 5.0
"""More company than this doesn't count."""
_MOVING_MPS = 2.0
_FREE_M = 1.5
"""Room before and behind, so that its body may be longer."""
_LONGEST_M = 12.0


def best_ego(net: Network, state: State, cars: Array, step: int, step_s: float) -> int:
    """Choose among movers, after a trial of some seconds: who moves on, in company, and isn't far from the middle."""
    trial, sizes = State(*(field.copy() for field in state)), sizes_of(state)
    motor = np.flatnonzero(state.movers["kind"] == DRIVE)
    here = poses_of(net, state, 0.0)
    company, speed, slowest = np.zeros(len(cars)), np.zeros(len(cars)), np.full(len(cars), np.inf)
    num = int(_TRIAL_S / step_s)
    for k in range(num):
        if k % _EVERY == 0:
            company += np.minimum(_company(poses_of(net, trial, 0.0), cars, motor), _ENOUGH) * _EVERY / num
        decide(net, trial, sizes, step + k, step_s)
        v = trial.movers["speed_mps"][cars]
        speed += v / num
        slowest = np.minimum(slowest, v) if k * step_s < _START_S else slowest
        advance(net, trial, step_s)
    limit = np.array([min(net.lanes["speed_mps"][state.way[i, HERE]], state.movers["fastest_mps"][i]) for i in cars])
    sees = _company(here, cars, motor, ahead_m=_AT_ONCE_M, behind_m=0.0) > 0
    score = company / _ENOUGH + np.minimum(speed / limit, 0.8) + 0.5 * sees + (slowest > _MOVING_MPS)
    score -= 1.5 * np.maximum(_border(here[:, :2])[cars] - 0.6, 0.0)
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


def _border(here: Float64) -> Float64:
    """How far from the middle everybody (N,) is: 1 at the border."""
    middle = here - (here.min(axis=0) + here.max(axis=0)) / 2
    return np.asarray(np.abs(middle / np.maximum(np.abs(middle).max(axis=0), 1.0)).max(axis=1))


def _has_room(net: Network, state: State, cars: Array) -> Array:
    """Which cars (K,) are not changing lanes and have nobody just before or behind them."""
    taken, sides, room = occupied(net, state), left_sides(state.movers), np.zeros(len(cars), bool)
    for row, i in enumerate(cars):
        ahead, _ = leader(net.roads, state.movers, state.way[i], taken, i, 50.0)
        same = taken.first[state.way[i, HERE]], taken.first[state.way[i, HERE] + 1]
        who, at = taken.who[slice(*same)], taken.at_m[slice(*same)]
        behind = at[(who != i) & (at <= state.movers["at_m"][i])]
        gap = state.movers["at_m"][i] - behind.max(initial=-np.inf) - _LONGEST_M
        room[row] = ahead > _FREE_M and gap > _FREE_M and sides[i] == 0
    return room
