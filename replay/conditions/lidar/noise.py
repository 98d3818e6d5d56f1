"""Points that a LiDAR sees elsewhere than they are: noise of all, strays of some, errors of the motion in a sweep."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from fbench.replay.conditions.points import OnClouds, draw_rows, for_clouds
from fbench.replay.contracts.conditions import Level, Need, Site
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.data.messages import PointCloud

_SIGMAS_M = (0.02, 0.04, 0.06, 0.08, 0.10)
_KNOTS = 11  # Errors of the pose along a sweep, linear between


class Jitter(OnClouds):
    """Normal noise along each axis: xyz += N(0, sigma). Levels of Dong et al. (CVPR 2023)."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"sigma_m": _SIGMAS_M}

    @for_clouds
    def disturb(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Draw along each axis."""
        rng = site.rng_of(cloud)
        noise = rng.standard_normal(cloud.xyz.shape, np.float32) * np.float32(level["sigma_m"])
        return replace(cloud, xyz=cloud.xyz + noise)


class UniformNoise(OnClouds):
    """Even noise along each axis: xyz += U(-c, c). Levels of Dong et al. (CVPR 2023)."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"half_width_m": _SIGMAS_M}

    @for_clouds
    def disturb(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Draw along each axis."""
        share = site.rng_of(cloud).random(cloud.xyz.shape, np.float32) * np.float32(2) - np.float32(1)
        return replace(cloud, xyz=cloud.xyz + share * np.float32(level["half_width_m"]))


class BulkMotion(OnClouds):
    """The whole sweep is off by a common N(0, sigma) along each axis, and each point by N(0, sigma / 10) more: shocks,
    vibration. Levels after Robo3D (Kong et al., ICCV 2023): 0.04, 0.08, 0.10 m.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"sigma_m": _SIGMAS_M}

    @for_clouds
    def disturb(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Draw the common part first."""
        rng, sigma = site.rng_of(cloud), np.float32(level["sigma_m"])
        common, own = rng.standard_normal(3, np.float32), rng.standard_normal(cloud.xyz.shape, np.float32)
        shift: Array = (common + own / np.float32(10)) * sigma
        return replace(cloud, xyz=cloud.xyz + shift)


def stray(cloud: PointCloud, share: float, draw: Callable[[int, np.random.Generator], Array], site: Site) -> PointCloud:
    """Return the cloud with round(share * N) points, drawn without replacement, off by what `draw` gives for so many
    (num, 3) [m].
    """
    rng, xyz = site.rng_of(cloud), cloud.xyz.copy()
    rows = draw_rows(rng, len(xyz), share)
    xyz[rows] += draw(len(rows), rng).astype(np.float32)
    return replace(cloud, xyz=xyz)


def stray_normally(cloud: PointCloud, level: Level, site: Site) -> PointCloud:
    """Return the cloud with a share of its points off by N(0, sigma) along each axis."""
    return stray(cloud, level["share"], lambda num, rng: rng.normal(0.0, level["sigma_m"], (num, 3)), site)


class Impulse(OnClouds):
    """A share of the points is off by 0.1 m along each axis, to either side. Levels of Dong et al. (CVPR 2023): one in
    30, 25, 20, 15, 10.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {
        "share": (1 / 30, 1 / 25, 1 / 20, 1 / 15, 1 / 10), "off_m": (0.1,) * 5,
    }  # fmt: skip

    @for_clouds
    def disturb(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Draw the sides."""

        def draw(num: int, rng: np.random.Generator) -> Array:
            return (rng.integers(0, 2, (num, 3)) * 2 - 1) * level["off_m"]

        return stray(cloud, level["share"], draw, site)


class Crosstalk(OnClouds):
    """Pulses of other LiDARs: a share of the points is off by N(0, 3 m) along each axis. Levels of Dong et al. (CVPR
    2023); Robo3D has 0.6 to 1 %, and 3 % for nuScenes.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {
        "share": (0.004, 0.008, 0.012, 0.016, 0.02), "sigma_m": (3.0,) * 5,
    }  # fmt: skip

    @for_clouds
    def disturb(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Move a share of the points."""
        return stray_normally(cloud, level, site)


class Glare(OnClouds):
    """Light of the sun in the receiver: a share of the points is off by N(0, 2 m) along each axis. Levels of Dong et
    al. (CVPR 2023).
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {
        "share": (0.01, 0.02, 0.03, 0.04, 0.05), "sigma_m": (2.0,) * 5,
    }  # fmt: skip

    @for_clouds
    def disturb(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Move a share of the points."""
        return stray_normally(cloud, level, site)


class DeskewError(OnClouds):
    """The motion within a sweep is compensated by wrong poses: at 11 instants from the first to the last point the pose
    is off by N(0, sigma) along and N(0, sigma) about each axis of the sensor, and linearly in between; the rotation is
    the exponential of its vector (Rodrigues), so that shapes stay rigid at each instant. Levels of Dong et al. (CVPR
    2023).
    """

    needs: ClassVar[Sequence[Need]] = ("time",)
    levels: ClassVar[Mapping[str, Sequence[float]]] = {
        "sigma_m": _SIGMAS_M, "sigma_rad": (0.002, 0.004, 0.006, 0.008, 0.010),
    }  # fmt: skip

    @for_clouds
    def disturb(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Move every point by the error at its instant."""
        at_ns = np.zeros(len(cloud.xyz)) if cloud.offset_ns is None else cloud.offset_ns.astype(np.float64)
        sigma = np.repeat([level["sigma_m"], level["sigma_rad"]], 3)
        error = site.rng_of(cloud).standard_normal((_KNOTS, 6)) * sigma
        instants = np.linspace(at_ns.min(), at_ns.max(), _KNOTS)
        off = np.stack([np.interp(at_ns, instants, error[:, i]) for i in range(6)], axis=1)
        return replace(cloud, xyz=(turn_by(off[:, 3:], cloud.xyz.astype(np.float64)) + off[:, :3]).astype(np.float32))


def turn_by(vector_rad: Float64, xyz: Float64) -> Float64:
    """Turn points (N, 3) each by a rotation vector (N, 3): cos a p + sin a (k x p) + (1 - cos a) (k . p) k (Rodrigues),
    a its length and k its direction.
    """
    angle = np.sqrt((vector_rad * vector_rad).sum(axis=1))[:, None]
    axis = vector_rad / np.where(angle > 0, angle, 1.0)
    along = (axis * xyz).sum(axis=1)[:, None]
    return np.asarray(np.cos(angle) * xyz + np.sin(angle) * np.cross(axis, xyz) + (1 - np.cos(angle)) * along * axis)
