"""In which order, when and where to a spinning LiDAR shoots."""

from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.rig import LidarSpec
from fbench.replay.arrays import Array, Float64, freeze_fields


@dataclass(frozen=True, eq=False)
class Firing:
    """The N shots of one turn, in firing order."""

    direction: Float64
    """(N, 3) unit vectors in the sensor's coordinates."""
    ring: Array
    """(N,) uint16 channel, 0 the highest."""
    offset_ns: Array
    """(N,) int32 time after the turn's end, at which the last shot is made: none is above 0."""

    def __post_init__(self) -> None:
        freeze_fields(self, direction=("f8", ("N", 3)), ring=("u2", ("N",)), offset_ns=("i4", ("N",)))


def firing(spec: LidarSpec) -> Firing:
    """Return the shots of one turn: `points_per_s / rate_hz` of them, to the nearest.

    Shot k is channel k modulo `channels`. Channels lie evenly from `upper_deg` down to `lower_deg`, one alone lies in
    between. The head starts backwards and turns clockwise seen from above (back, left, front, right), a step a shot.
    """
    num = max(1, round(spec.points_per_s / spec.rate_hz))
    shot = np.arange(num)
    ring = shot % spec.channels
    azimuth = np.pi - shot * (2 * np.pi / num)
    altitude = _altitudes_rad(spec)
    flat, up = np.cos(altitude)[ring], np.sin(altitude)[ring]
    direction = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], axis=1)
    offset_ns = np.rint((shot - (num - 1)) * (1e9 / spec.rate_hz / num))
    return Firing(direction, ring.astype(np.uint16), offset_ns.astype(np.int32))


def _altitudes_rad(spec: LidarSpec) -> Float64:
    if spec.channels == 1:
        return np.radians([(spec.upper_deg + spec.lower_deg) / 2])
    return np.radians(np.linspace(spec.upper_deg, spec.lower_deg, spec.channels))
