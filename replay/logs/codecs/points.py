"""Names, meanings and time stamps of point fields, as drivers write them."""

from collections.abc import Iterable
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np

from fbench.replay.data.arrays import Array, Float32, Float64
from fbench.replay.data.messages import PointCloud, RadarScan

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


TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time")
_NS_PER_S = 1_000_000_000
_LIMITS = np.iinfo(np.int32)


def offset_ns(times: Array, stamp_ns: int) -> Array | None:
    """Return the times (N,) int32 after `stamp_ns` [ns], or `None` where their meaning isn't clear.

    Integers of 32 bits are ns after the stamp (Ouster `t`, Livox `offset_time`). Floats are seconds: all within
    an int32 of ns around 0 are relative (Velodyne `time`), all that near the stamp are absolute (Hesai, RoboSense
    `timestamp`). What can be both (stamps of the first seconds since 1970), anything else, and what an int32 doesn't
    hold stays unknown: milliseconds of a whole sweep, say.
    """
    if not len(times):
        return np.zeros(0, np.int32)
    if times.dtype.kind == "f":
        seconds = times.astype(np.float64)
        relative, absolute = _fitting(seconds * _NS_PER_S), _fitting(_since(seconds, stamp_ns))
        if relative is None or absolute is None:
            return absolute if relative is None else relative
        return None
    return _fitting(times.astype(np.float64)) if times.dtype.itemsize == 4 else None


def _since(seconds: Float64, stamp_ns: int) -> Float64:
    """Absolute seconds as ns after the stamp; whole seconds are taken off first, which loses nothing."""
    whole, rest = divmod(stamp_ns, _NS_PER_S)
    return (seconds - whole) * _NS_PER_S - rest


def _fitting(ns: Float64) -> Array | None:
    fits = bool(np.all((ns >= _LIMITS.min) & (ns <= _LIMITS.max)))
    return np.rint(ns).astype(np.int32) if fits else None


C = TypeVar("C", PointCloud, RadarScan)


def only_finite(cloud: C) -> C:
    """Return a cloud without the points of which a coordinate isn't finite."""
    if np.isfinite(cloud.xyz).all():
        return cloud
    good = np.isfinite(cloud.xyz).all(axis=1)
    values = {f.name: getattr(cloud, f.name) for f in fields(cloud)}
    points: dict[str, Any] = {name: v[good] for name, v in values.items() if isinstance(v, np.ndarray)}
    return replace(cloud, **points)
