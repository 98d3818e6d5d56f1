"""Compiled search for the speed of a radar among mostly stationary echoes."""

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.kernels import kernel

_ACROSS = 1e-6
"""Forward share of directions across the way, along which no speed forward can be told."""
_MARGIN_MPS = 1e-6
"""More than rounding does to the limits of what is searched."""


@kernel
def agreement(
    direction: Float64,
    velocity_mps: Float64,
    forward_mps: Float64,
    sideways_mps: Float64,
    period_mps: float,
    band_mps: float,
) -> Float64:
    """Score candidate velocities of a radar; `forward_mps` (F,), ascending, and `sideways_mps` (S,) span them.

    Returns (F, S): the sum over echoes of max(0, 1 - |r| / band), r being what remains of an echo's radial velocity
    when the sensor's motion is taken away, to the nearest multiple of `period_mps` (0: velocities are unambiguous).
    """
    result = np.zeros((len(forward_mps), len(sideways_mps)))
    for i in range(len(velocity_mps)):
        for s in range(len(sideways_mps)):
            aside_mps = sideways_mps[s] * direction[i, 1]
            first, last = 0, len(forward_mps)
            if period_mps <= 0 and abs(direction[i, 0]) > _ACROSS:
                # All but a few candidates leave too much of this echo.
                middle = -(velocity_mps[i] + aside_mps) / direction[i, 0]
                reach = band_mps / abs(direction[i, 0]) + _MARGIN_MPS
                first, last = np.searchsorted(forward_mps, middle - reach), np.searchsorted(forward_mps, middle + reach)
            for f in range(first, last):
                r = velocity_mps[i] + forward_mps[f] * direction[i, 0] + aside_mps
                if period_mps > 0:
                    r -= period_mps * np.floor(r / period_mps + 0.5)
                if abs(r) < band_mps:
                    result[f, s] += 1.0 - abs(r) / band_mps
    return result
