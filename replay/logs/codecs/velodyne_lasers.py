"""Lasers of Velodyne LiDARs: directions, heights and firing times, as the user manuals give them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.data.arrays import Array, Float64


@dataclass(frozen=True, eq=False)
class Lasers:
    """The lasers of one model, in the order in which a packet has them."""

    cos_elevation: Float64
    sin_elevation: Float64
    azimuth_rad: Float64  # To be added to that of the block
    height_m: Float64  # Where the beam leaves the vertical axis
    ring: Array  # uint16, 0 at the bottom
    resolution_m: float  # Of distances
    cycle_ns: float  # From one firing of all lasers to the next
    step_ns: float  # From one firing to the next
    at_once: int = 1  # Lasers that fire together


_VLS128_DEG = (
    -11.742, -1.99, 3.4, -5.29, -0.78, 4.61, -4.08, 1.31, -6.5, -1.11, 4.28, -4.41, 0.1, 6.48, -3.2, 2.19, -3.86,
    1.53, -9.244, -1.77, 2.74, -5.95, -0.56, 4.83, -2.98, 2.41, -6.28, -0.89, 3.62, -5.07, 0.32, 7.58, -0.34, 5.18,
    -3.64, 1.75, -25, -2.43, 2.96, -5.73, 0.54, 9.7, -2.76, 2.63, -7.65, -1.55, 3.84, -4.85, 3.18, -5.51, -0.12,
    5.73, -4.3, 1.09, -16.042, -2.21, 4.06, -4.63, 0.76, 15, -3.42, 1.97, -6.85, -1.33, -5.62, -0.23, 5.43, -3.53,
    0.98, -19.582, -2.32, 3.07, -4.74, 0.65, 11.75, -2.65, 1.86, -7.15, -1.44, 3.95, -2.1, 3.29, -5.4, -0.01, 4.5,
    -4.19, 1.2, -13.565, -1.22, 4.17, -4.52, 0.87, 6.08, -3.31, 2.08, -6.65, 1.42, -10.346, -1.88, 3.51, -6.06,
    -0.67, 4.72, -3.97, 2.3, -6.39, -1, 4.39, -5.18, 0.21, 6.98, -3.09, 4.98, -3.75, 1.64, -8.352, -2.54, 2.85,
    -5.84, -0.45, 8.43, -2.87, 2.52, -6.17, -1.66, 3.73, -4.96, 0.43,
)  # fmt: skip
_VLS128_AZIMUTHS_DEG = (6.354, 4.548, 2.732, 0.911, -0.911, -2.732, -4.548, -6.354)  # Of each eight
_VLP32C_DEG = (
    -25, -1, -1.667, -15.639, -11.31, 0, -0.667, -8.843, -7.254, 0.333, -0.333, -6.148, -5.333, 1.333, 0.667, -4,
    -4.667, 1.667, 1, -3.667, -3.333, 3.333, 2.333, -2.667, -3, 7, 4.667, -2.333, -2, 15, 10.333, -1.333,
)  # fmt: skip
_VLP32C_AZIMUTHS_DEG = (
    1.4, -4.2, 1.4, -1.4, 1.4, -1.4, 4.2, -1.4, 1.4, -4.2, 1.4, -1.4, 4.2, -1.4, 4.2, -1.4, 1.4, -4.2, 1.4, -4.2,
    4.2, -1.4, 1.4, -1.4, 1.4, -1.4, 1.4, -4.2, 4.2, -1.4, 1.4, -1.4,
)  # fmt: skip


def _make(
    elevation_deg: Sequence[float], focus_m: float, resolution_m: float, times_ns: tuple[float, float, int],
    azimuth_deg: Sequence[float] = (0.0,),
) -> Lasers:  # fmt: skip
    """Beams meet `focus_m` in front of the axis, which tells the height at which each leaves it."""
    elevation = np.deg2rad(np.array(elevation_deg))
    azimuth = np.resize(np.deg2rad(np.array(azimuth_deg)), len(elevation))
    ring = np.argsort(np.argsort(elevation, kind="stable"), kind="stable").astype(np.uint16)
    height = -focus_m * np.tan(elevation)
    return Lasers(np.cos(elevation), np.sin(elevation), azimuth, height, ring, resolution_m, *times_ns)


_PUCK_NS = (55_296.0, 2_304.0, 1)
LASERS: Mapping[int, Lasers] = {
    0x21: _make(  # HDL-32E
        [round((i // 2 * 4 - (28 if i % 2 else 92)) / 3, 2) for i in range(32)], 28.83e-3, 0.002,
        (46_080.0, 1_152.0, 1),
    ),
    0x22: _make([i if i % 2 else i - 15 for i in range(16)], 41.91e-3, 0.002, _PUCK_NS),  # VLP-16, Puck LITE
    0x24: _make([round(2 * i / 3 if i % 2 else 2 * i / 3 - 10, 3) for i in range(16)], 41.91e-3, 0.002, _PUCK_NS),
    0x28: _make(_VLP32C_DEG, 42.4e-3, 0.004, (55_296.0, 2_304.0, 2), _VLP32C_AZIMUTHS_DEG),
    0xA1: _make(_VLS128_DEG, 58.63e-3, 0.004, (0.0, 0.0, 8), _VLS128_AZIMUTHS_DEG),  # timing is in its decoder
}  # fmt: skip
"""By the factory byte of a packet; 0x24 is a Puck Hi-Res, 0x28 a VLP-32C (Ultra Puck), 0xA1 a VLS-128 (Alpha Prime)."""
