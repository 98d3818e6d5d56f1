"""Car following: the intelligent driver model.

Treiber, Hennecke, Helbing, "Congested traffic states in empirical observations and microscopic simulations", Phys. Rev.
E 62 (2000), equations 2 to 4; above the desired speed as in the "improved" model of Treiber, Kesting, "Traffic Flow
Dynamics" (2013), section 11.3.7, where nobody brakes harder than comfortable because of a speed limit alone.
"""

import numpy as np

from fbench.replay.kernels import kernel

HARDEST_MPS2 = 8.0
"""Full braking on a dry road."""


@kernel
def free_acceleration(v: float, desired: float, a: float, b: float) -> float:
    """Acceleration [m/s^2] on an empty road: a (1 - (v / v0)^4) up to the desired speed, at least -b above it."""
    if v <= desired:
        ratio = v / desired
        return a * (1.0 - ratio * ratio * ratio * ratio)
    value: float = -b * (1.0 - (desired / v) ** (4.0 * a / b))
    return value


@kernel
def interaction(v: float, gap: float, closing: float, headway: float, standing: float, a: float, b: float) -> float:
    """How much less [m/s^2] because of a leader at a net gap that shrinks at `closing` [m/s]: a (s* / s)^2."""
    wanted = standing + max(0.0, v * headway + 0.5 * v * closing / np.sqrt(a * b))
    ratio = wanted / max(gap, 0.01)
    value: float = a * ratio * ratio
    return value


@kernel
def limited(acceleration: float) -> float:
    """What brakes can do."""
    return max(acceleration, -HARDEST_MPS2)
