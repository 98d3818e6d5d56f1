"""The world at one instant: poses of all bodies (x east, y north, z up), and rays with what they hit."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.data.arrays import Array, Bool, Float32, Float64, Int64, freeze_fields

EGO = 0  # Index of the vehicle that carries the sensors; all others are track ids too
BRAKE, HEAD, TAIL = 0, 1, 2  # Lamps of bodies (`Mesh.lamp`): brake lights shine while braking, the others by night


@dataclass(frozen=True, eq=False)
class BodyStates:
    """N bodies at one instant; the same bodies in the same order throughout a log."""

    time_s: float  # Since the log's beginning
    position_m: Float64  # (N, 3) the middle of the body's footprint, on the ground that it stands on
    yaw_rad: Float64  # (N,) about z, from x towards y
    velocity_mps: Float64  # (N, 3) of that point: the derivative of `position_m`
    yaw_rate_radps: Float64  # (N,)
    phase: Float64  # (N,) of the gait or the pedals, from 0 to below 1; 0 for what has none
    braking: Bool  # (N,) whether brake lights shine
    lamps: Bool  # (L,) which lamps of the static world shine: those of traffic signals, by the number in `Mesh.lamp`

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


STATIC, MISS = -1, -2  # What a ray hit that hit no actor: the static world, or nothing within its range


@dataclass(frozen=True, eq=False)
class Rays:
    """N rays in world coordinates."""

    origin_m: Float64  # (N, 3), or (1, 3) for all of them
    direction: Float32  # (N, 3) unit vectors
    range_m: float  # How far they go
    offset_s: Float64 | None = None
    """(N,) how long after the states' instant each is shot; bodies move on at constant velocity and turn rate."""

    def __post_init__(self) -> None:
        # kernels are compiled for contiguous arrays only
        object.__setattr__(self, "origin_m", np.ascontiguousarray(self.origin_m))
        object.__setattr__(self, "direction", np.ascontiguousarray(self.direction))
        freeze_fields(self, origin_m=("f8", ("M", 3)), direction=("f4", ("N", 3)), offset_s=("f8", ("N",)))


@dataclass(frozen=True, eq=False)
class Hits:
    """What N rays hit first."""

    range_m: Float32  # (N,), infinite where nothing was hit
    body: Array  # (N,) int32 index of the actor, `STATIC` or `MISS`
    triangle: Array  # (N,) int32 of the mesh that was hit (of the phase in which the actor is), -1 where nothing was
    normal: Float32
    """(N, 3) unit vectors in the world, towards the side where the ray comes from; 0 where nothing was hit."""
    alone: tuple[tuple[int, Int64], ...]
    """For every actor that a ray would hit if it were alone in the world: its index and those of these rays, both
    ascending. The share of them that `body` confirms is what is visible of it."""
