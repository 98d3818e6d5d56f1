"""A linear Kalman filter for many tracks at once, with constant rates.

A state is a measured vector z followed by the rates of its components. Steps are the textbook's (R. E. Kalman, 1960):
predict x = F x, P = F P F' + Q; update with the gain K = P H' (H P H' + R)^-1. Components don't influence each other,
because neither noise nor motion links them, so that of P only a 2 by 2 block for each component isn't zero, and both
steps have a closed form. Standard deviations are given per component, (m,) for all tracks or (T, m) for each.
"""

from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Array, Float64

PLACE, RATE, PLACE_VAR, COVARIANCE, RATE_VAR = range(5)
"""Rows of `States.values`: of each component its value, its rate, and the block of P: of both variances and covariance.
"""


@dataclass(frozen=True, eq=False)
class States:
    """Means and covariances of T tracks."""

    values: Float64
    """(5, T, m), see `PLACE` and those after it."""

    def __len__(self) -> int:
        return int(self.values.shape[1])

    @property
    def place(self) -> Float64:
        """(T, m) what is measured."""
        place: Float64 = self.values[PLACE]
        return place

    @property
    def rate(self) -> Float64:
        """(T, m) its change in a second."""
        rate: Float64 = self.values[RATE]
        return rate

    @property
    def place_var(self) -> Float64:
        """(T, m) variance of `place`."""
        place_var: Float64 = self.values[PLACE_VAR]
        return place_var

    def rows(self, rows: Array) -> "States":
        """Select tracks by mask or index array."""
        return States(self.values[:, rows])

    def overwritten(self, at: Array, new: "States") -> "States":
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
    place, rate, place_var, covariance, rate_var = states.values
    q = drift_std**2
    values = np.empty_like(states.values)
    values[PLACE], values[RATE] = place + dt_s * rate, rate
    shared = dt_s * covariance
    values[PLACE_VAR] = place_var + shared + shared + dt_s * rate_var * dt_s + q * dt_s**3 / 3
    values[COVARIANCE] = covariance + dt_s * rate_var + q * dt_s**2 / 2
    values[RATE_VAR] = rate_var + q * dt_s
    return States(values)


def update(states: States, measured: Float64, measured_std: Float64) -> States:
    """Correct each state with one measurement, (T, m)."""
    before, place_var, covariance = states.values, states.values[PLACE_VAR], states.values[COVARIANCE]
    gains = before[PLACE_VAR : COVARIANCE + 1] * (1 / (place_var + measured_std**2))
    gain, rate_gain = gains
    values = np.empty_like(before)
    values[: RATE + 1] = before[: RATE + 1] + gains * (measured - states.place)
    values[PLACE_VAR : COVARIANCE + 1] = before[PLACE_VAR : COVARIANCE + 1] - gain * before[PLACE_VAR : COVARIANCE + 1]
    # Both are the same but for rounding: so the block stays symmetric.
    values[COVARIANCE] = (values[COVARIANCE] + (covariance - rate_gain * place_var)) / 2
    values[RATE_VAR] = before[RATE_VAR] - rate_gain * covariance
    return States(values)


def join(first: States, second: States) -> States:
    """Put two sets of states into one."""
    return States(np.concatenate([first.values, second.values], axis=1))
