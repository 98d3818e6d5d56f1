"""Joints of a person: proportions, and limbs that reach a place."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fbench.replay.arrays import Array, Float64

UPPER_ARM, FOREARM, THIGH, SHANK, FOOT = 0.186, 0.146, 0.245, 0.246, 0.152
SHOULDER_HALF, HIP_HALF, ANKLE = 0.112, 0.052, 0.039
HIP, SHOULDER = 0.53, 0.818
"""Lengths as shares of the standing height (Drillis and Contini 1966, as in Winter, Biomechanics and Motor Control of
Human Movement, fig. 4.1); the joints of shoulders and hips lie further in than its widths over all."""
SIDES: Final = np.array([1.0, -1.0])
"""Left, right along y."""


@dataclass(frozen=True, eq=False)
class Pose:
    """Where the joints of one person are [m]; pairs are left, right."""

    height_m: float
    """Standing."""
    pelvis: Float64
    """(3,) between the hips."""
    neck: Float64
    """(3,) between the shoulders."""
    head: Float64
    """(3,) its middle."""
    shoulders: Float64
    elbows: Float64
    wrists: Float64
    hips: Float64
    knees: Float64
    ankles: Float64
    toes: Float64
    """(2, 3) each; the tip of the shoe's sole."""


def turned(angle_rad: Array, length_m: float) -> Float64:
    """Vectors (N, 3) of a limb that hangs down, swung forward by angles (N,)."""
    angle = np.asarray(angle_rad, np.float64)
    return np.asarray(length_m * np.column_stack([np.sin(angle), 0 * angle, -np.cos(angle)]), np.float64)


def bent(start: Array, end: Array, upper_m: float, lower_m: float, towards: Array) -> Float64:
    """Return where the joint (3,) between two bones lies that go from start to end, bent towards a direction (3,)."""
    line = np.asarray(end, np.float64) - start
    reach = float(np.sqrt((line * line).sum()))
    axis = line / reach
    side = np.asarray(towards, np.float64) - (axis * towards).sum() * axis
    side /= np.sqrt((side * side).sum())
    along = (upper_m**2 - lower_m**2 + reach**2) / (2 * reach)
    out = np.sqrt(max(upper_m**2 - along**2, 0.0))
    return np.asarray(start + min(along, upper_m) * axis + out * side, np.float64)


def pair(x: Array | float, y: float, z: Array | float) -> Float64:
    """Return places (2, 3) on the left and on the right."""
    return np.column_stack([np.broadcast_to(x, 2), SIDES * y, np.broadcast_to(z, 2)]).astype(np.float64)
