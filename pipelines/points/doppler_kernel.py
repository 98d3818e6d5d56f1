"""Compiled search for the speed of a radar among mostly stationary echoes."""

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.kernels import kernel


@kernel
def agreement(
    direction: Float64,
    velocity_mps: Float64,
    forward_mps: Float64,
    sideways_mps: Float64,
    period_mps: float,
    band_mps: float,
) -> Float64:
    """Score candidate velocities of a radar; `forward_mps` (F,) and `sideways_mps` (S,) span the candidates.

    Returns (F, S): the sum over echoes of max(0, 1 - |r| / band), r being what remains of an echo's radial velocity
    when the sensor's motion is taken away, to the nearest multiple of `period_mps` (0: velocities are unambiguous).
    """
    result = np.zeros((len(forward_mps), len(sideways_mps)))
    for f in range(len(forward_mps)):
        for s in range(len(sideways_mps)):
            total = 0.0
            for i in range(len(velocity_mps)):
                r = velocity_mps[i] + forward_mps[f] * direction[i, 0] + sideways_mps[s] * direction[i, 1]
                if period_mps > 0:
                    r -= period_mps * np.floor(r / period_mps + 0.5)
                total += max(0.0, 1.0 - abs(r) / band_mps)
            result[f, s] = total
    return result
