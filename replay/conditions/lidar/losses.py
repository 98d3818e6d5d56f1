"""Points that a LiDAR loses: beams, a share of all, views to the side, holes, parts of objects, shadows."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from fbench.replay.conditions import objects
from fbench.replay.conditions.points import OnClouds, count_share, draw_mask, for_clouds, keep_points, smallest
from fbench.replay.contracts.conditions import Level, Need, Site
from fbench.replay.data.arrays import Float64
from fbench.replay.data.messages import PointCloud
from fbench.replay.data.rig import Kind
from fbench.replay.geometry.transforms import transform


class BeamDrop(OnClouds):
    """Whole beams are dead for the whole log: round(share * rings) of the rings that a cloud has, drawn without
    replacement, each log's own.

    Levels of Robo3D (Kong et al., ICCV 2023), where 48, 32, 16 of 64 are left, and of MultiCorrupt (Beemelmanns et al.
    2024), 16, 8, 4 of 32.
    """

    needs: ClassVar[Sequence[Need]] = ("ring",)
    levels: ClassVar[Mapping[str, Sequence[float]]] = {"lost_share": (0.25, 0.5, 0.625, 0.75, 0.875)}

    @for_clouds
    def disturb(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Order all rings by random numbers of the log, and drop the first of those that the cloud has."""
        rings = np.unique(np.zeros(0, np.uint16) if cloud.ring is None else cloud.ring)
        if cloud.ring is None or len(rings) < 2:
            return cloud
        order = site.rng("beams").random(int(rings[-1]) + 1)[rings]
        dead = np.zeros(int(rings[-1]) + 1, bool)
        num = min(count_share(len(rings), level["lost_share"]), len(rings) - 1)
        dead[rings[np.argsort(order, kind="stable")[:num]]] = True
        return keep_points(cloud, np.asarray(~dead[cloud.ring]))


class Density(OnClouds):
    """Points are lost, whatever they are of: round(share * N), drawn without replacement.

    Levels of Dong et al. (CVPR 2023): up to 30 %.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"lost_share": (0.06, 0.12, 0.18, 0.24, 0.30)}

    @for_clouds
    def disturb(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Draw what is lost."""
        return keep_points(cloud, ~draw_mask(site.rng_of(cloud), len(cloud.xyz), level["lost_share"]))


class FieldOfView(OnClouds):
    """Only points ahead are left: |azimuth| <= half of the field of view, from the sensor, in the body's axes.

    Levels of Dong et al. (CVPR 2023): 105 to 45 degrees to each side.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"half_fov_deg": (105.0, 90.0, 75.0, 60.0, 45.0)}

    @for_clouds
    def disturb(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Compare azimuths; points without one stay."""
        x, y, _ = _toward(cloud, site).T
        return keep_points(cloud, np.asarray(~(np.abs(np.arctan2(y, x)) > np.radians(level["half_fov_deg"]))))


class Cutout(OnClouds):
    """Holes: of each the 2 % of the cloud's points that are nearest to one of its points, drawn evenly from those that
    are left. Equally near ones go in their order.

    Levels of Dong et al. (CVPR 2023): 2 to 10 holes.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {
        "holes": (2.0, 3.0, 5.0, 7.0, 10.0), "share_each": (0.02,) * 5,
    }  # fmt: skip

    @for_clouds
    def disturb(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Cut one hole after the other."""
        rng, left = site.rng_of(cloud), np.flatnonzero(np.isfinite(cloud.xyz).all(axis=1))
        keep = np.ones(len(cloud.xyz), bool)
        for _ in range(round(level["holes"])):
            num = min(count_share(len(keep), level["share_each"]), len(left) - 1)
            if num < 1:
                break
            xyz = cloud.xyz[left].astype(np.float64)
            away = xyz - xyz[int(rng.integers(len(left)))]
            cut = smallest(away[:, 0] * away[:, 0] + away[:, 1] * away[:, 1] + away[:, 2] * away[:, 2], num)
            keep[left[cut]] = False
            left = np.delete(left, cut)
        return keep_points(cloud, keep)


class IncompleteEcho(objects.Density):
    """Of each labeled object most points give no echo, as of dark or shiny ones: round(share * points), at least one.

    Levels after Robo3D (Kong et al., ICCV 2023): 75, 85, 95 %.
    """

    kinds: ClassVar[Sequence[Kind]] = ("lidar",)
    levels: ClassVar[Mapping[str, Sequence[float]]] = {"removed_share": (0.55, 0.65, 0.75, 0.85, 0.95)}


class Occluder(OnClouds):
    """A wall across the view, at 8 m from the sensor, at one azimuth for the whole log, up to 60 degrees from straight
    ahead: what lies behind it, however high, is gone. Its own echoes aren't added.

    Widths are chosen: from a post to a truck's side.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {
        "width_m": (0.5, 1.0, 2.0, 3.0, 4.0), "distance_m": (8.0,) * 5,
    }  # fmt: skip

    @for_clouds
    def disturb(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Remove what is farther along the axis of the shadow than the wall, and within its angle."""
        azimuth = np.radians(site.rng("azimuth").uniform(-60.0, 60.0))
        x, y, _ = _toward(cloud, site).T
        along, across = np.cos(azimuth) * x + np.sin(azimuth) * y, np.cos(azimuth) * y - np.sin(azimuth) * x
        distance_m = level["distance_m"]
        hidden = (along > distance_m) & (np.abs(across) < along * (level["width_m"] / 2 / distance_m))
        return keep_points(cloud, np.asarray(~hidden))


def _toward(cloud: PointCloud, site: Site) -> Float64:
    """Points (N, 3) from the sensor, in the body's axes [m]."""
    turn = site.rig.body_T_sensor(cloud.sensor).copy()
    turn[:3, 3] = 0.0
    return transform(turn, cloud.xyz)
