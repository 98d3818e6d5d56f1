"""A linear Kalman filter for many tracks at once, with constant rates.

A state is a measured vector z followed by the rates of its components. Steps are the textbook's (R. E. Kalman, 1960):
predict x = F x, P = F P F' + Q; update with the gain K = P H' (H P H' + R)^-1. Components don't influence each other,
because neither noise nor motion links them, so that of P only a 2 by 2 block for each component isn't zero, and both
steps have a closed form. Standard deviations are given per component, (m,) for all tracks or (T, m) for each.
"""

from typing import TypeAlias

import numpy as np

from fbench.pipelines.tracking.kernels import correct_states, one_layout, predict_states
from fbench.replay.data.arrays import Float64

States: TypeAlias = Float64
"""Means and covariances (5, T, m) of T tracks: of each component its value, its rate, and the block of P, of which both
variances and the covariance."""
PLACE, RATE, PLACE_VAR, COVARIANCE, RATE_VAR = range(5)  # Rows of `States`


def begin(measured: Float64, rates: Float64, measured_std: Float64, rate_std: Float64) -> States:
    """New states from measurements (T, m) and first guesses of the rates (T, m)."""
    values = np.zeros((5, *measured.shape))
    values[PLACE], values[RATE], values[PLACE_VAR], values[RATE_VAR] = measured, rates, measured_std**2, rate_std**2
    return values


def predict(states: States, dt_s: float, drift_std: Float64) -> States:
    """Move all states by `dt_s` > 0.

    Rates do a random walk with a standard deviation of `drift_std` (m,) or (T, m) after one second: for each
    component Q = drift_std^2 [[dt^3 / 3, dt^2 / 2], [dt^2 / 2, dt]] (Bar-Shalom et al., Estimation, 2001, 6.2.2).
    """
    return predict_states(one_layout(states), dt_s, dt_s**2, dt_s**3, _each(drift_std, states))


def begin_identity(measured: Float64, rates: Float64, place_var: float, rate_var: float) -> States:
    """New states as `begin` makes them, with P = `place_var` I, but `rate_var` for rates."""
    return begin(
        measured, rates, np.full(measured.shape, np.sqrt(place_var)), np.full(measured.shape, np.sqrt(rate_var))
    )


def predict_identity(states: States, dt_s: float, step_var: float) -> States:
    """Move all states by `dt_s` > 0 with Q = `step_var` I, however long the step is."""
    moved = predict(states, dt_s, np.zeros(states.shape[2]))
    moved[PLACE_VAR] += step_var
    moved[RATE_VAR] += step_var
    return moved


def update(states: States, measured: Float64, measured_std: Float64) -> States:
    """Correct each state with one measurement, (T, m)."""
    return correct_states(one_layout(states), one_layout(measured), _each(measured_std, states))


def _each(std: Float64, states: States) -> Float64:
    each = np.empty(states.shape[1:])
    each[:] = std
    return each
