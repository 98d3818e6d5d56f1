"""The world of the built-in demo log: boxes that drive, boxes that stand, and rays that hit them."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.data import Float64, Int64

EGO_SPEED_MPS = 8.0
PERIOD_M = 200.0
"""Along the road everything repeats, so that the road never ends."""
_CLEARANCE_M = 0.1
GROUND, MISS = -1, -2


@dataclass(frozen=True)
class Body:
    """One box on the ground, as it is at time 0 in world coordinates; track 0: a thing that isn't labelled."""

    track: int
    label: str
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    size_lwh_m: tuple[float, float, float]


_CAR, _VAN, _TRUCK = (4.5, 1.8, 1.5), (5.2, 2.0, 2.2), (10.0, 2.5, 3.2)
BODIES = (
    Body(1, "car", 22, 0, 0, EGO_SPEED_MPS, _CAR),
    Body(2, "van", 34, -3.6, 0, 6.5, _VAN),
    Body(3, "car", 75, 3.6, np.pi, 9, _CAR),
    Body(4, "truck", 190, 3.6, np.pi, 9, _TRUCK),
    Body(5, "car", 100, -25, np.pi / 2, 7, _CAR),
    Body(6, "car", 45, 8, 0.15, 0, _CAR),
    *(Body(0, "wall", x, y, 0, 0, (30, 0.4, 3)) for x in (-50, 0, 50) for y in (-14, 14)),
    *(Body(0, "pole", x, y, 0, 0, (0.3, 0.3, 5)) for x in (-75, -25, 25, 75) for y in (-8, 11)),
)


@dataclass(frozen=True, eq=False)
class Scene:
    """All bodies at one instant, in the ego's body coordinates (its axes are the world's: it drives along x)."""

    center_m: Float64
    """(N, 3)."""
    size_lwh_m: Float64
    yaw_rad: Float64
    velocity_mps: Float64
    """(N, 3) over ground."""
    track: Int64


def ego_x_m(time_s: float) -> float:
    """Where the ego is on the road."""
    return EGO_SPEED_MPS * time_s


def scene(time_s: float) -> Scene:
    """Move all bodies to `time_s`; one that leaves behind the ego comes back ahead of it under another track id."""
    yaw = np.array([b.yaw_rad for b in BODIES])
    speed = np.array([b.speed_mps for b in BODIES])
    size = np.array([b.size_lwh_m for b in BODIES])
    velocity = np.stack([speed * np.cos(yaw), speed * np.sin(yaw), np.zeros(len(BODIES))], axis=1)
    x = np.array([b.x_m for b in BODIES]) + velocity[:, 0] * time_s - ego_x_m(time_s) + PERIOD_M / 2
    y = np.array([b.y_m for b in BODIES]) + velocity[:, 1] * time_s
    lap = np.floor(x / PERIOD_M)
    center = np.stack([x - lap * PERIOD_M - PERIOD_M / 2, y, _CLEARANCE_M + size[:, 2] / 2], axis=1)
    track = np.array([b.track for b in BODIES])
    return Scene(center, size, yaw, velocity, np.where(track > 0, track + 100 * np.abs(lap).astype(np.int64), 0))


def cast(at: Scene, origin_m: Float64, direction: Float64, max_m: float) -> tuple[Float64, Int64]:
    """Follow rays from `origin_m` (3,) along unit vectors (N, 3).

    Returns ranges (N,) [m] and what was hit (N,): the index of a body, `GROUND`, or `MISS` beyond `max_m`. Bodies are
    hit by the slab method: Kay and Kajiya, "Ray Tracing Complex Scenes", SIGGRAPH 1986.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        down = -origin_m[2] / direction[:, 2]
        nearest = np.where(direction[:, 2] < 0, down, np.inf)
        hit = np.full(len(direction), GROUND)
        for i in range(len(at.center_m)):
            distance = _slabs(at, i, origin_m, direction)
            closer = distance < nearest
            nearest, hit = np.where(closer, distance, nearest), np.where(closer, i, hit)
    hit[nearest > max_m] = MISS
    return nearest, hit


def _slabs(at: Scene, i: int, origin_m: Float64, direction: Float64) -> Float64:
    """Range (N,) at which rays enter body `i`, infinite where they miss it."""
    cos, sin = np.cos(at.yaw_rad[i]), np.sin(at.yaw_rad[i])
    start = origin_m - at.center_m[i]
    starts = (cos * start[0] + sin * start[1], cos * start[1] - sin * start[0], start[2])
    x, y, z = direction.T
    enter, leave = np.zeros(len(direction)), np.full(len(direction), np.inf)
    for s, d, half in zip(starts, (cos * x + sin * y, cos * y - sin * x, z), at.size_lwh_m[i] / 2, strict=True):
        a, b = (-half - s) / d, (half - s) / d
        enter, leave = np.maximum(enter, np.minimum(a, b)), np.minimum(leave, np.maximum(a, b))
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)
