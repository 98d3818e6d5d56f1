"""Which car carries the sensors: one that drives, in the midst of others."""

import numpy as np

from fbench.datasets.city.traffic.network import Network
from fbench.datasets.city.traffic.occupancy_kernel import leader, left_side, occupancy
from fbench.datasets.city.traffic.path_kernel import poses
from fbench.datasets.city.traffic.state import HERE, State
from fbench.datasets.city.traffic.step_kernel import advance, decide
from fbench.replay.arrays import Array, Float64

_AHEAD_S, _NEAR_M = 6.0, 60.0
_FREE_M = 1.5
"""Room before and behind, so that its body may be longer."""
_LONGEST_M = 12.0


def best_ego(net: Network, state: State, cars: Array, step: int, step_s: float) -> int:
    """Choose among movers: who drives fast for some seconds, has company, and isn't far from the middle."""
    trial, sizes = State(*(field.copy() for field in state)), sizes_of(state)
    here = poses(net, state, 0.0)[:, :2]
    num = int(_AHEAD_S / step_s)
    slowest = np.full(len(cars), np.inf)
    for k in range(num):
        decide(net, trial, sizes, step + k, step_s)
        slowest = np.minimum(slowest, trial.movers["speed_mps"][cars])
        advance(net, trial, step_s)
    limit = np.array([min(net.lanes["speed_mps"][state.way[i, HERE]], state.movers["fastest_mps"][i]) for i in cars])
    away = _distances(here[cars], here)
    company = np.minimum((away < _NEAR_M).sum(axis=1) / 10.0, 1.0)
    middle = here - (here.min(axis=0) + here.max(axis=0)) / 2
    border = np.abs(middle / np.maximum(np.abs(middle).max(axis=0), 1.0)).max(axis=1)[cars]
    score = np.minimum(slowest / limit, 0.8) + 0.5 * company - 1.5 * np.maximum(border - 0.4, 0.0)
    return int(cars[np.argmax(np.where(_has_room(net, state, cars), score, -np.inf))])


def sizes_of(state: State) -> Float64:
    """Footprints (N, 2)."""
    return np.column_stack([state.movers["length_m"], state.movers["width_m"]])


def _has_room(net: Network, state: State, cars: Array) -> Array:
    """Which cars (K,) are not changing lanes and have nobody just before or behind them."""
    taken, room = occupancy(net, state), np.zeros(len(cars), bool)
    for row, i in enumerate(cars):
        ahead, _ = leader(net, state, taken, i, 0, 50.0)
        same = taken.first[state.way[i, HERE]], taken.first[state.way[i, HERE] + 1]
        who, at = taken.who[slice(*same)], taken.at_m[slice(*same)]
        behind = at[(who != i) & (at <= state.movers["at_m"][i])]
        gap = state.movers["at_m"][i] - behind.max(initial=-np.inf) - _LONGEST_M
        room[row] = ahead > _FREE_M and gap > _FREE_M and left_side(state, i) == 0
    return room


def _distances(a: Float64, b: Float64) -> Float64:
    apart = a[:, None, :] - b[None, :, :]
    return np.asarray(np.sqrt((apart * apart).sum(axis=2)))
