"""Detection by all LiDARs, and by all radars, in all images of a rig, timed."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fbench.pipelines.imaging.cloud import of_lidar, of_radar, viewpoint
from fbench.pipelines.imaging.params import LidarImageParams, RadarImageParams
from fbench.pipelines.imaging.rays import Rays
from fbench.pipelines.imaging.sightings import Sightings, by_boxes, by_points
from fbench.pipelines.imaging.spots import Points, SpotParams, spots
from fbench.pipelines.points import radar
from fbench.pipelines.points.lidar_stage import LidarStage
from fbench.pipelines.points.radar import Compensated, RadarParams, RadarView
from fbench.pipelines.points.radar_stage import RadarStage
from fbench.pipelines.stages import StageClock
from fbench.replay.arrays import Float64
from fbench.replay.data import Frame, Rig, Source


@dataclass(frozen=True, eq=False)
class InImages:
    """What one kind of sensor sees, by camera; nothing of it where no sensor delivered."""

    seen: Mapping[str, Sightings] = field(default_factory=dict)
    points: Mapping[str, Points] = field(default_factory=dict)
    """Those over the ground."""
    rays: Mapping[str, Rays] = field(default_factory=dict)
    """All points."""


class LidarInImages:
    """Clusters of LiDAR points in images."""

    def __init__(self, rig: Rig, cameras: tuple[str, ...], stage: LidarStage, params: LidarImageParams) -> None:
        self._rig, self._cameras, self._stage = rig, cameras, stage
        self._params = SpotParams(params.cluster, params.shape, params.margin_px)
        self._viewpoint = viewpoint(rig, "lidar")

    def view(self, frame: Frame, clock: StageClock) -> InImages:
        """Detect in the points of one frame."""
        xyz = self._stage.points(frame, clock)
        if xyz is None:
            return InImages()
        cloud = of_lidar(self._stage.obstacles(xyz, clock), self._viewpoint)
        with clock.stage("detect.lidar"):
            found = {name: spots(self._rig, name, cloud, self._params) for name in self._cameras}
            return InImages(
                {name: by_points(one, Source.L) for name, (_, one) in found.items()},
                {name: points for name, (points, _) in found.items()},
                all_rays(self._rig, self._cameras, xyz),
            )


class RadarInImages:
    """Clusters of radar echoes in images; of sparse radars what they see in space, projected."""

    def __init__(
        self, rig: Rig, cameras: tuple[str, ...], stage: RadarStage, params: RadarParams, image: RadarImageParams
    ) -> None:
        self._rig, self._cameras, self._stage, self._radar, self._image = rig, cameras, stage, params, image
        self._params = SpotParams(image.cluster, image.shape, image.margin_px)
        self._viewpoint = viewpoint(rig, "radar")

    def view(self, frame: Frame, clock: StageClock) -> InImages:
        """Detect in the echoes of one frame."""
        echoes = self._stage.echoes(frame, clock)
        if echoes is None:
            return InImages()
        with clock.stage("preprocess"):
            cloud = of_radar(echoes, self._viewpoint, self._radar.min_speed_mps, self._image)
        with clock.stage("detect.radar"):
            if cloud.plane is None:
                return InImages(in_images(self._rig, self._cameras, radar.detect(echoes, self._radar), echoes))
            found = {name: spots(self._rig, name, cloud, self._params) for name in self._cameras}
            return InImages(
                {name: by_points(one, Source.R) for name, (_, one) in found.items()},
                {name: points for name, (points, _) in found.items()},
                all_rays(self._rig, self._cameras, echoes.xyz),
            )


def all_rays(rig: Rig, cameras: tuple[str, ...], xyz: Float64) -> dict[str, Rays]:
    """Points (N, 3) in body coordinates as each camera sees them."""
    return {name: Rays.of(rig, name, xyz) for name in cameras}


def in_images(rig: Rig, cameras: tuple[str, ...], view: RadarView, echoes: Compensated) -> dict[str, Sightings]:
    """What radars see in space, as each camera sees it."""
    rate = relative_rates(view, echoes)
    return {name: by_boxes(rig, name, view.boxes, rate, Source.R) for name in cameras}


def relative_rates(view: RadarView, echoes: Compensated) -> Float64:
    """Change of the distance (M,) [m/s] of each of a view's boxes, positive when receding; NaN where unknown.

    That is its velocity along the line of sight over ground, less the radar's own.
    """
    result = np.full(len(view.boxes), np.nan)
    velocity = view.boxes.velocity_mps
    if velocity is None:
        return result
    for at in range(len(view.boxes)):
        rows = view.cluster == at
        own = echoes.own_mps[rows]
        if np.isfinite(own).any():
            ray = np.nanmedian(view.xyz[rows], axis=0)[:2]
            along = velocity[at, :2] @ ray / max(float(np.hypot(*ray)), 1e-9)
            result[at] = along - np.nanmedian(own)
    return result
