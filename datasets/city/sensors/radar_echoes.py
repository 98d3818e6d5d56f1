"""Echoes of one radar scan on their way from the surface to the message."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from fbench.replay.arrays import Array, Float64, freeze_fields


@dataclass(frozen=True, eq=False)
class Echoes:
    """K echoes, in polar coordinates of the sensor: azimuth from x towards y, altitude from there towards z."""

    range_m: Float64
    azimuth_rad: Float64
    altitude_rad: Float64
    speed_mps: Float64
    """(K,) along the ray, positive when receding, relative to the sensor."""
    rcs_dbsm: Float64
    """(K,) what the sensor takes for the radar cross-section: lower by what the air took."""
    margin_db: Float64
    """(K,) how far the echo is above the weakest that the sensor finds."""
    body: Array
    """(K,) int32 index of the actor, `STATIC`, or `MISS` of echoes where nothing is."""
    true_range_m: Float64
    """(K,) of the surface, NaN where nothing is."""

    def __post_init__(self) -> None:
        one = ("f8", ("K",))
        freeze_fields(
            self, range_m=one, azimuth_rad=one, altitude_rad=one, speed_mps=one, rcs_dbsm=one, margin_db=one,
            body=("i4", ("K",)), true_range_m=one,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.range_m)

    def __getitem__(self, rows: Array) -> Self:
        """Select echoes by mask or index array."""
        return type(self)(*(getattr(self, field.name)[rows] for field in fields(self)))


def joined(parts: Sequence[Echoes]) -> Echoes:
    """Join echoes, in their order."""
    return Echoes(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Echoes)))


def directions(azimuth_rad: Float64, altitude_rad: Float64) -> Float64:
    """Return unit vectors (K, 3) in the sensor's axes: cos phi cos theta, cos phi sin theta, sin phi."""
    flat = np.cos(altitude_rad)
    return np.stack([flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(altitude_rad)], axis=1)
