"""The compiled steps of `kalman`, where the closed forms and the five rows of states are explained."""

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.kernels import kernel


@kernel
def predicted(values: Float64, dt_s: float, dt_s2: float, dt_s3: float, drift_std: Float64) -> Float64:
    """Move states (5, T, m) by `dt_s`, whose powers come along, with the rates' drift (T, m) in one second."""
    result = np.empty_like(values)
    for t in range(values.shape[1]):
        for k in range(values.shape[2]):
            place, rate = values[0, t, k], values[1, t, k]
            place_var, covariance, rate_var = values[2, t, k], values[3, t, k], values[4, t, k]
            q = drift_std[t, k] * drift_std[t, k]
            shared = dt_s * covariance
            result[0, t, k] = place + dt_s * rate
            result[1, t, k] = rate
            result[2, t, k] = place_var + shared + shared + dt_s * rate_var * dt_s + q * dt_s3 / 3
            result[3, t, k] = covariance + dt_s * rate_var + q * dt_s2 / 2
            result[4, t, k] = rate_var + q * dt_s
    return result


@kernel
def corrected(values: Float64, measured: Float64, measured_std: Float64) -> Float64:
    """Correct states (5, T, m) with one measurement each (T, m), its standard deviation likewise."""
    result = np.empty_like(values)
    for t in range(values.shape[1]):
        for k in range(values.shape[2]):
            place, rate = values[0, t, k], values[1, t, k]
            place_var, covariance, rate_var = values[2, t, k], values[3, t, k], values[4, t, k]
            weight = np.divide(1.0, place_var + measured_std[t, k] * measured_std[t, k])
            gain, rate_gain, apart = place_var * weight, covariance * weight, measured[t, k] - place
            result[0, t, k] = place + gain * apart
            result[1, t, k] = rate + rate_gain * apart
            result[2, t, k] = place_var - gain * place_var
            # Both are the same but for rounding: so the block stays symmetric.
            result[3, t, k] = (covariance - gain * covariance + (covariance - rate_gain * place_var)) / 2
            result[4, t, k] = rate_var - rate_gain * covariance
    return result
