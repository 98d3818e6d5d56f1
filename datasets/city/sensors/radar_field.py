"""Where a radar looks."""

from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.rig import RadarSpec
from fbench.replay.arrays import Float64, freeze_fields

_GOLDEN = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True, eq=False)
class Looks:
    """The rays of one scan in polar coordinates of the sensor."""

    azimuth_rad: Float64
    altitude_rad: Float64
    solid_angle_sr: Float64
    """(N,) of the field of view, which part each ray stands for."""

    def __post_init__(self) -> None:
        one = ("f8", ("N",))
        freeze_fields(self, azimuth_rad=one, altitude_rad=one, solid_angle_sr=one)


def looks(spec: RadarSpec, rng: np.random.Generator) -> Looks:
    """Return points_per_s / rate_hz rays, spread evenly over azimuth and altitude, never where they were before.

    A golden-ratio lattice at a random place: every part of the field of view gets its share of rays in every scan.
    """
    num = max(1, round(spec.points_per_s / spec.rate_hz))
    width, height = np.radians(spec.horizontal_fov_deg), np.radians(spec.vertical_fov_deg)
    shift = rng.random(2)
    i = np.arange(num)
    azimuth = ((i + shift[0]) / num - 0.5) * width
    altitude = ((i * _GOLDEN + shift[1]) % 1 - 0.5) * height
    return Looks(azimuth, altitude, np.cos(altitude) * (width * height / num))
