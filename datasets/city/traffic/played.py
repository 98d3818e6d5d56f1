"""Some time of the traffic, frozen."""

from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.motion import BodyStates
from fbench.datasets.city.traffic.network import Network
from fbench.datasets.city.traffic.state import State
from fbench.datasets.city.traffic.step import poses_of
from fbench.datasets.city.world.city_map import SignalPlan
from fbench.replay.arrays import Bool, Float64
from fbench.replay.errors import ConfigError


@dataclass(frozen=True, eq=False)
class PlayedMotion:
    """What everybody does in some steps; implements `Motion`."""

    net: Network
    signals: SignalPlan
    states: tuple[State, ...]
    """One for each step, as decided at its beginning."""
    first_step: int
    step_s: float
    from_s: float
    to_s: float
    parked: Float64
    """(K, 4) x, y, z, yaw."""

    def at(self, time_s: float) -> BodyStates:
        """Return the bodies at a time from `from_s` to `to_s`.

        Raises:
            ConfigError: at another time.
        """
        if not self.from_s - 1e-9 <= time_s <= self.to_s + 1e-9:
            raise ConfigError(f"motion: expected a time from {self.from_s:g} to {self.to_s:g} s, got {time_s:g} s")
        step = step_of(time_s, self.step_s)
        state = self.states[min(max(step - self.first_step, 0), len(self.states) - 1)]
        since = max(time_s - step * self.step_s, 0.0)
        moving, still = poses_of(self.net, state, since), np.zeros(len(self.parked))
        return BodyStates(
            float(time_s),
            np.concatenate([moving[:, :3], self.parked[:, :3]]),
            np.concatenate([moving[:, 6], self.parked[:, 3]]),
            np.concatenate([moving[:, 3:6], np.zeros((len(self.parked), 3))]),
            np.concatenate([moving[:, 7], still]),
            np.concatenate([_phase(state, moving[:, 8]), still]),
            np.concatenate([state.movers["braking"], still > 0]),
            _lamps(self.signals, time_s),
        )


def step_of(time_s: float, step_s: float) -> int:
    """The step in which a time is; borders belong to the step that begins there, give or take rounding."""
    return int(np.floor(time_s / step_s + 1e-9))


def _phase(state: State, gone: Float64) -> Float64:
    movers, walks = state.movers, state.movers["cycle_m"] > 0
    cycles = (movers["base_m"] + movers["at_m"] + gone) / np.where(walks, movers["cycle_m"], 1.0)
    phase: Float64 = np.where(walks, cycles - np.floor(cycles), 0.0)
    return np.where(phase < 1.0, phase, 0.0)


def _lamps(signals: SignalPlan, time_s: float) -> Bool:
    """Red, yellow and green of every group, (3 G,)."""
    green, yellow = signals.is_green(time_s), signals.is_yellow(time_s)
    lamps: Bool = np.column_stack([~green & ~yellow, yellow & ~green, green]).ravel()
    return lamps
