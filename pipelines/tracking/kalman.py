"""A linear Kalman filter for many tracks at once, with constant rates.

A state is a measured vector z followed by the rates of its components. Steps are the textbook's (R. E. Kalman, 1960):
predict x = F x, P = F P F' + Q; update with the gain K = P H' (H P H' + R)^-1. Components don't influence each other,
because neither noise nor motion links them, so that of P only a 2 by 2 block for each component isn't zero, and both
steps have a closed form. Standard deviations are given per component, (m,) for all tracks or (T, m) for each.
"""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.tracking.kernels import correct_states, one_layout, predict_states
from fbench.replay.data.arrays import Float64, Int64

PLACE, RATE, PLACE_VAR, COVARIANCE, RATE_VAR = range(5)
"""Rows of `States.values`: of each component its value, its rate, and the block of P: of both variances and covariance.
"""


@dataclass(frozen=True, eq=False)
class States:
    """Means and covariances of T tracks."""

    values: Float64  # (5, T, m), see `PLACE` and those after it

    def __len__(self) -> int:
        return int(self.values.shape[1])

    @property
    def place(self) -> Float64:
        """(T, m) what is measured."""
        return np.asarray(self.values[PLACE])

    @property
    def rate(self) -> Float64:
        """(T, m) its change in a second."""
        return np.asarray(self.values[RATE])

    @property
    def place_var(self) -> Float64:
        """(T, m) variance of `place`."""
        return np.asarray(self.values[PLACE_VAR])

    def rows(self, rows: Int64) -> "States":
        """Select tracks by index."""
        return States(self.values.take(rows, axis=1))

    def replace_rows(self, at: Int64, new: "States") -> "States":
        """Replace the tracks `at`."""
        values = self.values.copy()
        values[:, at] = new.values
        return States(values)


def begin(measured: Float64, rates: Float64, measured_std: Float64, rate_std: Float64) -> States:
    """New states from measurements (T, m) and first guesses of the rates (T, m)."""
    values = np.zeros((5, *measured.shape))
    values[PLACE], values[RATE], values[PLACE_VAR], values[RATE_VAR] = measured, rates, measured_std**2, rate_std**2
    return States(values)


def predict(states: States, dt_s: float, drift_std: Float64) -> States:
    """Move all states by `dt_s` > 0.

    Rates do a random walk with a standard deviation of `drift_std` (m,) or (T, m) after one second: for each
    component Q = drift_std^2 [[dt^3 / 3, dt^2 / 2], [dt^2 / 2, dt]] (Bar-Shalom et al., Estimation, 2001, 6.2.2).
    """
    return States(predict_states(one_layout(states.values), dt_s, dt_s**2, dt_s**3, _each(drift_std, states)))


def update(states: States, measured: Float64, measured_std: Float64) -> States:
    """Correct each state with one measurement, (T, m)."""
    return States(correct_states(one_layout(states.values), one_layout(measured), _each(measured_std, states)))


def _each(std: Float64, states: States) -> Float64:
    each = np.empty(states.values.shape[1:])
    each[:] = std
    return each


def join(first: States, second: States) -> States:
    """Put two sets of states into one."""
    return States(np.concatenate([first.values, second.values], axis=1))
