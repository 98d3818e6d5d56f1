"""The names that drivers give to the fields of points (in any case), and what the values mean."""

from collections.abc import Iterable

import numpy as np

from fbench.replay.arrays import Array, Float32, Float64

DOPPLER_FIELDS = (
    "velocity", "doppler", "doppler_velocity", "radial_velocity", "v_r", "vr", "radial_speed", "speed_radial",
    "v_radial", "v_rad", "vrad", "velocity_radial", "radial_vel", "vel_radial", "radialvelocity", "radialspeed",
    "doppler_speed", "doppler_vel", "dopplervelocity", "v_doppler", "range_rate", "rangerate", "doppler_mps",
    "v_doppler_mps", "radial_velocity_mps", "doppler_velocity_mps", "range_rate_mps", "v_rel", "vrel",
)  # fmt: skip
"""A cloud with one of these fields is a radar scan; their values count as positive when receding."""
VECTOR_FIELDS = ("vx", "vy")
"""Doppler as a vector along the ray, as nuScenes has it (its `vx_comp, vy_comp` are made free of the ego motion)."""
RCS_FIELDS = ("rcs", "power", "snr", "amplitude")
RANGE_FIELDS = ("range",)
AZIMUTH_FIELDS = ("azimuth", "azimuthangle")
ALTITUDE_FIELDS = ("altitude", "elevation", "elevationangle")
INTENSITY_FIELDS = ("intensity", "reflectivity", "i")
RING_FIELDS = ("ring", "channel", "line")


def is_radar(names: Iterable[str]) -> bool:
    """Tell whether points with these fields have a Doppler velocity."""
    lower = {name.lower() for name in names}
    return not lower.isdisjoint(DOPPLER_FIELDS) or lower.issuperset(VECTOR_FIELDS)


def ring_numbers(column: Array | None) -> Array | None:
    """Numbers of the lasers (N,) uint16; `None` where they aren't such numbers."""
    if column is None or column.dtype == np.uint16:
        return column
    if not np.all((column >= 0) & (column <= np.iinfo(np.uint16).max) & (column == np.trunc(column))):
        return None
    return column.astype(np.uint16)


def along_ray(xyz: Float32, vx: Float64, vy: Float64) -> Float32:
    """Radial velocity (N,) of vectors in the sensor's coordinates: (x vx + y vy) / hypot(x, y), NaN on its axis."""
    x, y = xyz[:, 0].astype(np.float64), xyz[:, 1].astype(np.float64)
    with np.errstate(all="ignore"):  # what isn't finite is dealt with where it matters
        radial: Float32 = ((x * vx + y * vy) / np.hypot(x, y)).astype(np.float32)
    return radial
