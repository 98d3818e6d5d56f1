"""What LiDARs and radars detect in space, projected into all images of a rig, timed."""

import numpy as np

from fbench.pipelines.imaging.sensors import InImages, all_rays, in_images
from fbench.pipelines.imaging.sightings import by_boxes
from fbench.pipelines.points import radar
from fbench.pipelines.points.lidar_stage import LidarStage
from fbench.pipelines.points.radar import RadarParams
from fbench.pipelines.points.radar_stage import RadarStage
from fbench.pipelines.stages import StageClock
from fbench.replay.data import Frame, Rig, Source


def lidar_projected(rig: Rig, cameras: tuple[str, ...], stage: LidarStage, frame: Frame, clock: StageClock) -> InImages:
    """Boxes of LiDARs in space as each camera sees them, and where rays went; nothing where no LiDAR delivered."""
    xyz = stage.points(frame, clock)
    if xyz is None:
        return InImages()
    boxes = stage.detect(xyz, clock).boxes
    with clock.stage("detect.lidar"):
        unknown = np.full(len(boxes), np.nan)
        seen = {name: by_boxes(rig, name, boxes, unknown, Source.L) for name in cameras}
        return InImages(seen, rays=all_rays(rig, cameras, xyz))


def radar_projected(
    rig: Rig, cameras: tuple[str, ...], stage: RadarStage, params: RadarParams, frame: Frame, clock: StageClock
) -> InImages:
    """Boxes of radars in space as each camera sees them; nothing where no radar delivered.

    That radars see nothing at a place tells nothing: they find moving objects only.
    """
    echoes = stage.echoes(frame, clock)
    if echoes is None:
        return InImages()
    with clock.stage("detect.radar"):
        return InImages(in_images(rig, cameras, radar.detect(echoes, params), echoes))
