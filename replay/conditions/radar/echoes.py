"""Echoes of a radar scan: their margin above the sensor's floor, the speed of the ground, and directions."""

from dataclasses import replace

import numpy as np

from fbench.replay.conditions.points import polar
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.data.messages import RadarScan

_FLOOR_SHARE = 0.002  # Of a scan's echoes that are no stronger than the weakest that the sensor finds
_GROUPS, _ENOUGH, _WEAK_SHARE = 8, 160, 0.05
_NEIGHBORS = 15


def cartesian(range_m: Float64, azimuth_rad: Float64, altitude_rad: Float64) -> Float64:
    """Return the points (N, 3) of ranges, azimuths and altitudes (N,)."""
    flat = range_m * np.cos(altitude_rad)
    return np.stack([flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), range_m * np.sin(altitude_rad)], axis=1)


def append(scan: RadarScan, xyz: Float64, speed_mps: Float64, rcs_db: Float64) -> RadarScan:
    """Return the scan with M more points (M, 3) after its own, their radial velocities and cross-sections (M,)."""

    def join(own: Array | None, more: Array) -> Array | None:
        return None if own is None else np.concatenate([own, more.astype(np.float32)])

    range_m, azimuth, altitude = polar(xyz.astype(np.float32))
    return replace(
        scan, xyz=np.concatenate([scan.xyz, xyz.astype(np.float32)]),
        radial_velocity_mps=join(scan.radial_velocity_mps, speed_mps), rcs_dbsm=join(scan.rcs_dbsm, rcs_db),
        range_m=join(scan.range_m, range_m), azimuth_rad=join(scan.azimuth_rad, azimuth),
        altitude_rad=join(scan.altitude_rad, altitude),
    )  # fmt: skip


class Sensitivity:
    """The weakest echo that a sensor finds, by one of its scans.

    Received power falls with the range's fourth power, so the weakest cross-section found grows by 40 dB a decade.
    Sensors that give an uncalibrated magnitude have a weakest one that is the same everywhere: where in groups of
    ranges it grows by less than half of that, what they give is taken for received power. Without either all echoes
    count as equally large. The weakest is that which 0.2 % of the echoes don't reach.
    """

    def __init__(self, scan: RadarScan) -> None:
        range_m = np.maximum(polar(scan.xyz)[0], 0.1)
        strength = np.zeros(len(range_m)) if scan.rcs_dbsm is None else scan.rcs_dbsm.astype(np.float64)
        self.decade_db = _fall_db(range_m, strength)
        """40 of a cross-section, 0 of received power."""
        power = strength - self.decade_db * np.log10(range_m)
        known = power[np.isfinite(power)]
        at = int(len(known) * _FLOOR_SHARE)
        self.floor_db = float(np.partition(known, at)[at]) if len(known) else 0.0
        """The weakest received power, in the strength's unit at 1 m."""
        self.margin_db = np.where(np.isfinite(power), np.maximum(power - self.floor_db, 0.0), np.inf)
        """(N,) how far each echo is above it, at least; up to `step_db` more."""
        steps = np.diff(np.unique(strength[np.isfinite(strength)]))
        self.step_db = float(min(steps.min(initial=np.inf), 1.0)) if scan.rcs_dbsm is not None and len(steps) else 0.0
        """In which strengths are given."""

    def weakest_db(self, range_m: Float64) -> Float64:
        """Return the weakest strengths (M,) that are found at ranges (M,)."""
        return np.asarray(self.floor_db + self.decade_db * np.log10(np.maximum(range_m, 0.1)), np.float64)


def _fall_db(range_m: Float64, strength: Float64) -> float:
    """Slope of the weakest strengths of groups over 40 log10 of their ranges, 1 for cross-sections."""
    order = np.argsort(range_m, kind="stable")
    order = order[np.isfinite(strength[order]) & np.isfinite(range_m[order])]
    if len(order) < _ENOUGH or np.ptp(strength[order]) == 0:
        return 40.0
    groups = np.array_split(order, _GROUPS)
    weakest = np.array([np.sort(strength[rows])[int(len(rows) * _WEAK_SHARE)] for rows in groups])
    decades = np.array([float(np.log10(range_m[rows[len(rows) // 2]])) for rows in groups])
    off = decades - decades.mean()
    return 40.0 if float((off * weakest).sum()) >= 20.0 * float((off * off).sum()) else 0.0


def standing_mps(scan: RadarScan, azimuth_rad: Float64) -> Float64:
    """Return the radial velocities (M,) of what stands in directions (M,): the median of the 15 echoes that are nearest
    in azimuth. It needs no ambiguity of the sensor to be known; 0 for sensors without Doppler.
    """
    if scan.radial_velocity_mps is None:
        return np.zeros(len(azimuth_rad))
    own, speed = polar(scan.xyz)[1], scan.radial_velocity_mps.astype(np.float64)
    known = np.flatnonzero(np.isfinite(own) & np.isfinite(speed))
    if not len(known):
        return np.zeros(len(azimuth_rad))
    known = known[np.argsort(own[known], kind="stable")]
    num = min(_NEIGHBORS, len(known))
    first = np.clip(np.searchsorted(own[known], azimuth_rad) - num // 2, 0, len(known) - num)
    return np.asarray(np.median(speed[known][first[:, None] + np.arange(num)], axis=1), np.float64)
