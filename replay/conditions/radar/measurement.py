"""Echoes that a radar loses, merges, or measures wrongly: position, direction, strength and Doppler."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from fbench.replay.conditions.points import OnScans, draw_mask, draw_rows, for_scans, keep_points, move_points, polar
from fbench.replay.conditions.radar.echoes import Sensitivity, cartesian
from fbench.replay.contracts.conditions import Level, Need, Site
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.data.messages import RadarScan


class PointLoss(OnScans):
    """Echoes are lost: round(share * N), drawn without replacement. Class of RobuRCDet (2025), levels chosen."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"lost_share": (0.1, 0.2, 0.3, 0.4, 0.5)}

    @for_scans
    def disturb(self, scan: RadarScan, level: Level, site: Site) -> RadarScan:
        """Draw what is lost."""
        return keep_points(scan, ~draw_mask(site.rng_of(scan), len(scan.xyz), level["lost_share"]))


class Interference(OnScans):
    """Another radar raises the noise: echoes less than so much above the weakest are lost. The weakest is that of the
    scan, growing with the range's fourth power for cross-sections. Levels are chosen.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"noise_db": (3.0, 6.0, 9.0, 12.0, 15.0)}

    @for_scans
    def disturb(self, scan: RadarScan, level: Level, site: Site) -> RadarScan:
        """Lose the weak ones."""
        return keep_points(scan, np.asarray(Sensitivity(scan).margin_db >= level["noise_db"]))


class Shift(OnScans):
    """Points are off in the plane: x and y += N(0, sigma) each; Doppler and strength stay. Class of RobuRCDet (2025),
    levels chosen.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"sigma_m": (0.1, 0.2, 0.4, 0.8, 1.6)}

    @for_scans
    def disturb(self, scan: RadarScan, level: Level, site: Site) -> RadarScan:
        """Move all points."""
        xyz = scan.xyz.astype(np.float64)
        xyz[:, :2] += site.rng_of(scan).normal(0.0, level["sigma_m"], (len(xyz), 2))
        return move_points(scan, xyz)


class AzimuthError(OnScans):
    """Directions are off, as of few antennas or weak echoes: azimuth += N(0, sigma). Levels are chosen: from an eighth
    of a beam of 2 degrees to two of them.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"sigma_deg": (0.25, 0.5, 1.0, 2.0, 4.0)}

    @for_scans
    def disturb(self, scan: RadarScan, level: Level, site: Site) -> RadarScan:
        """Turn all points."""
        range_m, azimuth, altitude = polar(scan.xyz)
        azimuth = azimuth + np.radians(site.rng_of(scan).normal(0.0, level["sigma_deg"], len(azimuth)))
        return move_points(scan, cartesian(range_m, azimuth, altitude))


class Resolution(OnScans):
    """A coarser radar: of all echoes in one cell of range and azimuth one is left, in its middle, with the Doppler and
    altitude of the strongest; powers add up. Levels are chosen: from those of an imaging radar to those of a parking
    aid, each twice as coarse as the one before, so that cells lie in cells.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {
        "cell_m": (0.25, 0.5, 1.0, 2.0, 4.0), "cell_deg": (0.75, 1.5, 3.0, 6.0, 12.0),
    }  # fmt: skip

    @for_scans
    def disturb(self, scan: RadarScan, level: Level, site: Site) -> RadarScan:
        """Keep one echo a cell, in the order of the strongest ones. Raises ConfigError for cells without a size."""
        if level["cell_m"] <= 0:
            raise ConfigError("condition 'radar.resolution': expected cells above 0 m")
        scan = keep_points(scan, np.asarray(np.isfinite(scan.xyz).all(axis=1)))
        range_m, azimuth, altitude = polar(scan.xyz)
        width = np.radians(level["cell_deg"])
        far, across = np.floor(range_m / level["cell_m"]), np.floor(azimuth / width)
        strength = np.zeros(len(far)) if scan.rcs_dbsm is None else scan.rcs_dbsm.astype(np.float64)
        order = np.lexsort((-strength, across, far))
        starts = np.ones(len(order), bool)
        starts[1:] = (np.diff(far[order]) != 0) | (np.diff(across[order]) != 0)
        rows = order[starts]
        if scan.rcs_dbsm is not None and len(rows):
            power = np.add.reduceat(10 ** (strength[order] / 10), np.flatnonzero(starts))
            rcs = scan.rcs_dbsm.copy()
            rcs[rows] = (10 * np.log10(power)).astype(np.float32)
            scan = replace(scan, rcs_dbsm=rcs)
        is_first = np.zeros(len(far), bool)
        is_first[rows] = True
        rows = np.flatnonzero(is_first)
        middle = cartesian((far[rows] + 0.5) * level["cell_m"], (across[rows] + 0.5) * width, altitude[rows])
        return move_points(keep_points(scan, is_first), middle)


class Nonpositional(OnScans):
    """Strength and Doppler are off: += N(0, sigma) each, where the sensor gives them. Class of RobuRCDet (2025), levels
    chosen.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {
        "sigma_db": (1.0, 2.0, 4.0, 6.0, 8.0), "sigma_mps": (0.1, 0.25, 0.5, 1.0, 2.0),
    }  # fmt: skip

    @for_scans
    def disturb(self, scan: RadarScan, level: Level, site: Site) -> RadarScan:
        """Draw for all points. Raises LogError where the sensor gives neither."""
        if scan.rcs_dbsm is None and scan.radial_velocity_mps is None:
            raise LogError(f"condition 'radar.nonpositional' can't act: '{scan.sensor}' has no rcs, velocity", "COR002")
        normals = site.rng_of(scan).standard_normal((2, len(scan.xyz)))
        rcs, speed = scan.rcs_dbsm, scan.radial_velocity_mps
        return replace(
            scan,
            rcs_dbsm=None if rcs is None else (rcs + level["sigma_db"] * normals[0]).astype(np.float32),
            radial_velocity_mps=None if speed is None else (speed + level["sigma_mps"] * normals[1]).astype(np.float32),
        )


class DopplerAlias(OnScans):
    """Doppler is resolved wrongly: a share of the echoes, drawn without replacement, is off by one interval of
    ambiguity of 20 m/s towards 0, as of one chirp every 97 us at 77 GHz, wavelength / (2 T). Levels are chosen.
    """

    needs: ClassVar[Sequence[Need]] = ("velocity",)
    levels: ClassVar[Mapping[str, Sequence[float]]] = {
        "share": (0.02, 0.05, 0.1, 0.2, 0.4), "interval_mps": (20.0,) * 5,
    }  # fmt: skip

    @for_scans
    def disturb(self, scan: RadarScan, level: Level, site: Site) -> RadarScan:
        """Take from those that recede, add to those that approach."""
        if scan.radial_velocity_mps is None:
            return scan
        speed = scan.radial_velocity_mps.copy()
        rows = draw_rows(site.rng_of(scan), len(speed), level["share"])
        speed[rows] -= np.where(speed[rows] > 0, 1, -1).astype(np.float32) * np.float32(level["interval_mps"])
        return replace(scan, radial_velocity_mps=speed)
