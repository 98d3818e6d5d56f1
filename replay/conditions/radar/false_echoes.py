"""Echoes where nothing is: clutter, ghosts by multipath, spurious points. They come after a scan's own."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from fbench.replay.conditions.points import OnScans, count_share, draw_mask, for_scans, polar
from fbench.replay.conditions.radar.echoes import Sensitivity, append, cartesian, standing_mps
from fbench.replay.contracts.conditions import Level, Site
from fbench.replay.data.arrays import Float64
from fbench.replay.data.messages import RadarScan

_NEAREST_M = 1.0
_CLUTTER_DB, _CLUTTER_SIGMA_DB, _CLUTTER_MPS = -10.0, 5.0, 0.5
_GHOST_LOSS_DB, _GHOST_DETOUR_M = 10.0, (1.0, 10.0)


def add_clutter(scan: RadarScan, mean: float, rng: np.random.Generator) -> RadarScan:
    """Return the scan with Poisson many false echoes, evenly over its azimuths, their density falling with 1 / range.

    -10 dBsm with a deviation of 5 dB, or as much above the weakest for magnitudes; 0.5 m/s over ground: drops, spray,
    leaves. Altitudes are those of echoes.
    """
    num = int(rng.poisson(mean))
    range_m, azimuth, altitude = _known(scan)
    if not num or not len(range_m):
        return scan
    share, across = rng.random((2, num))
    farthest = max(float(range_m.max()), _NEAREST_M)
    at_m = _NEAREST_M * (farthest / _NEAREST_M) ** share
    to_rad = azimuth.min() + across * (azimuth.max() - azimuth.min())
    up_rad = altitude[rng.integers(0, len(altitude), num)]
    strength, sensitivity = rng.normal(0.0, _CLUTTER_SIGMA_DB, num), Sensitivity(scan)
    is_rcs = sensitivity.decade_db > 0
    rcs_db = _CLUTTER_DB + strength if is_rcs else sensitivity.weakest_db(at_m) + np.abs(strength)
    speed = standing_mps(scan, to_rad) + rng.normal(0.0, _CLUTTER_MPS, num)
    return append(scan, cartesian(at_m, to_rad, up_rad), speed, rcs_db)


class Clutter(OnScans):
    """False echoes near the sensor: Poisson many, range density 1 / r up to the farthest echo, N(-10, 5) dBsm, and
    N(0, 0.5) m/s over ground, which the scan's own echoes in that direction show. Levels are chosen.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"echoes": (2.0, 5.0, 10.0, 20.0, 40.0)}

    @for_scans
    def disturb(self, scan: RadarScan, level: Level, site: Site) -> RadarScan:
        """Add clutter."""
        return add_clutter(scan, level["echoes"], site.rng_of(scan))


class Ghost(OnScans):
    """Second echoes of strong ones, by way of another surface or of the ego vehicle: in the same direction, U(1, 10) m
    farther, 10 dB weaker, with once or, where the scan shows such speeds, twice the relative speed. Of those echoes
    whose ghost would still be found and is no farther than the farthest, a share has one. Levels are chosen; RobuRCDet
    (2025) counts them among spurious points.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"share": (0.05, 0.1, 0.2, 0.3, 0.5)}

    @for_scans
    def disturb(self, scan: RadarScan, level: Level, site: Site) -> RadarScan:
        """Add the ghosts, drawn without replacement, in the order of their echoes."""
        rng, sensitivity = site.rng_of(scan), Sensitivity(scan)
        range_m = polar(scan.xyz)[0]
        detour, twice = rng.random((2, len(range_m)))
        farther = range_m + _GHOST_DETOUR_M[0] + (_GHOST_DETOUR_M[1] - _GHOST_DETOUR_M[0]) * detour
        with np.errstate(invalid="ignore", divide="ignore"):
            needed = _GHOST_LOSS_DB + sensitivity.decade_db * np.log10(farther / range_m)
            strong = np.flatnonzero(
                (sensitivity.margin_db >= needed) & (farther <= np.nanmax(range_m, initial=0.0)) & (range_m > 0)
            )
        if not len(strong):
            return scan
        rows = strong[draw_mask(rng, len(strong), level["share"])]
        xyz = scan.xyz[rows].astype(np.float64) * (farther[rows] / range_m[rows])[:, None]
        own = np.zeros(len(range_m)) if scan.radial_velocity_mps is None else scan.radial_velocity_mps
        speed = own[rows].astype(np.float64)
        doubles = (twice[rows] < 0.5) & (2 * np.abs(speed) <= np.nanmax(np.abs(own), initial=0.0))
        rcs = np.zeros(len(rows)) if scan.rcs_dbsm is None else scan.rcs_dbsm[rows].astype(np.float64) - _GHOST_LOSS_DB
        return append(scan, xyz, np.where(doubles, 2 * speed, speed), rcs)


class Spurious(OnScans):
    """False points anywhere: a share of the number of echoes, evenly over the scan's azimuths and ranges, each with the
    altitude, the speed over ground, and the strength above the weakest of an echo. Class of RobuRCDet (2025), levels
    chosen.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"share": (0.1, 0.2, 0.3, 0.4, 0.5)}

    @for_scans
    def disturb(self, scan: RadarScan, level: Level, site: Site) -> RadarScan:
        """Add round(share * N) points."""
        rng, (range_m, azimuth, _) = site.rng_of(scan), _known(scan)
        if not len(range_m):
            return scan
        num = count_share(len(scan.xyz), level["share"])
        share, across = rng.random((2, num))
        like = np.flatnonzero(np.isfinite(scan.xyz).all(axis=1))[rng.integers(0, len(range_m), num)]
        at_m = range_m.min() + share * (range_m.max() - range_m.min())
        to_rad = azimuth.min() + across * (azimuth.max() - azimuth.min())
        sensitivity, like_rad = Sensitivity(scan), polar(scan.xyz[like])[1]
        speed = np.zeros(num)
        if scan.radial_velocity_mps is not None:
            over_ground = scan.radial_velocity_mps[like] - standing_mps(scan, like_rad)
            speed = standing_mps(scan, to_rad) + over_ground
        margin = sensitivity.margin_db[like]
        strength = sensitivity.weakest_db(at_m) + np.where(np.isfinite(margin), margin, 0.0)
        return append(scan, cartesian(at_m, to_rad, polar(scan.xyz[like])[2]), speed, strength)


def _known(scan: RadarScan) -> tuple[Float64, Float64, Float64]:
    """Polar coordinates of the points that have any."""
    range_m, azimuth, altitude = polar(scan.xyz)
    known = np.isfinite(range_m)
    return range_m[known], azimuth[known], altitude[known]
