"""A linear Kalman filter for many tracks at once, with constant rates.

A state is a measured vector followed by rates of some of its components. Steps are the textbook's (R. E. Kalman,
1960): predict x = F x, P = F P F' + Q; update with the gain K = P H' (H P H' + R)^-1. Standard deviations are given
per component, (m,) for all tracks or (T, m) for each.
"""

from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Array, Float64


@dataclass(frozen=True, eq=False)
class States:
    """Means and covariances of T tracks."""

    mean: Float64
    """(T, m + r): measured components, then rates."""
    cov: Float64
    """(T, m + r, m + r)."""

    def __len__(self) -> int:
        return len(self.mean)

    def rows(self, rows: Array) -> "States":
        """Select tracks by mask or index array."""
        return States(self.mean[rows], self.cov[rows])


def begin(measured: Float64, rates: Float64, measured_std: Float64, rate_std: Float64) -> States:
    """New states from measurements (T, m) and first guesses of the rates (T, r)."""
    mean = np.concatenate([measured, rates], axis=1)
    std = np.concatenate(
        [np.broadcast_to(measured_std, measured.shape), np.broadcast_to(rate_std, rates.shape)], axis=1
    )
    return States(mean, std[:, :, None] ** 2 * np.eye(mean.shape[1]))


def predict(states: States, dt_s: float, drift_std: Float64) -> States:
    """Move all states by `dt_s` > 0; the r measured components that come first have rates.

    Rates do a random walk with a standard deviation of `drift_std` (r,) or (T, r) after one second: for each
    component Q = drift_std^2 [[dt^3 / 3, dt^2 / 2], [dt^2 / 2, dt]] (Bar-Shalom et al., Estimation, 2001, 6.2.2).
    """
    num, rates = states.mean.shape[1], drift_std.shape[-1]
    i, j = np.arange(rates), np.arange(num - rates, num)
    F = np.eye(num)
    F[i, j] = dt_s
    q = np.broadcast_to(drift_std**2, (len(states), rates))
    noise = np.zeros_like(states.cov)
    noise[:, i, i] = q * dt_s**3 / 3
    noise[:, i, j] = noise[:, j, i] = q * dt_s**2 / 2
    noise[:, j, j] = q * dt_s
    mean = np.einsum("ij,tj->ti", F, states.mean)
    return States(mean, np.einsum("ij,tjk,lk->til", F, states.cov, F) + noise)


def update(states: States, measured: Float64, measured_std: Float64) -> States:
    """Correct each state with one measurement, (T, m)."""
    num = measured.shape[1]
    variance = np.broadcast_to(measured_std, measured.shape) ** 2
    spread = states.cov[:, :num, :num] + variance[:, :, None] * np.eye(num)
    gain = np.linalg.solve(spread, states.cov[:, :num, :]).transpose(0, 2, 1)
    mean = states.mean + np.einsum("tij,tj->ti", gain, measured - states.mean[:, :num])
    cov = states.cov - np.einsum("tij,tjk->tik", gain, states.cov[:, :num, :])
    return States(mean, (cov + cov.transpose(0, 2, 1)) / 2)


def join(first: States, second: States) -> States:
    """Put two sets of states into one."""
    return States(np.concatenate([first.mean, second.mean]), np.concatenate([first.cov, second.cov]))
