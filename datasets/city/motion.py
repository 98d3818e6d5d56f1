"""Poses of all bodies at an instant, in world coordinates: x east, y north, z up."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fbench.replay.data.arrays import Array, Bool, Float64, freeze_fields

EGO = 0
"""Index of the vehicle that carries the sensors; all others are track ids too."""
BRAKE, HEAD, TAIL = 0, 1, 2
"""Lamps of bodies (`Mesh.lamp`): brake lights shine while braking, the others by night."""


@dataclass(frozen=True, eq=False)
class BodyStates:
    """N bodies at one instant; the same bodies in the same order throughout a log."""

    time_s: float
    """Since the log's beginning."""
    position_m: Float64
    """(N, 3) the middle of the body's footprint, on the ground that it stands on."""
    yaw_rad: Float64
    """(N,) about z, from x towards y."""
    velocity_mps: Float64
    """(N, 3) of that point: the derivative of `position_m`."""
    yaw_rate_radps: Float64
    """(N,)."""
    phase: Float64
    """(N,) of the gait or the pedals, from 0 to below 1; 0 for what has none."""
    braking: Bool
    """(N,) whether brake lights shine."""
    lamps: Bool
    """(L,) which lamps of the static world shine: those of traffic signals, by the number in `Mesh.lamp`."""

    def __post_init__(self) -> None:
        freeze_fields(
            self, position_m=("f8", ("N", 3)), yaw_rad=("f8", ("N",)), velocity_mps=("f8", ("N", 3)),
            yaw_rate_radps=("f8", ("N",)), phase=("f8", ("N",)), braking=("?", ("N",)), lamps=("?", ("L",)),
        )  # fmt: skip

    def world_T_body(self, i: int) -> Float64:
        """Matrix (4, 4) that moves points from body `i` (origin in the middle of its footprint) to the world."""
        return world_T(self.position_m[i], float(self.yaw_rad[i]))


def world_T(position_m: Array, yaw_rad: float) -> Float64:
    """Matrix (4, 4) of an upright body at `position_m` (3,)."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    matrix = np.eye(4)
    matrix[:2, :2] = [[cos, -sin], [sin, cos]]
    matrix[:3, 3] = position_m
    return matrix


class Motion(Protocol):
    """What is known of all bodies over some time; never changes, so threads can share it."""

    def at(self, time_s: float) -> BodyStates:
        """Return the bodies at a time within `from_s` and `to_s` of `Traffic.motion`."""
        ...
