"""Detection by a stereo pair in all images of a rig, timed."""

from dataclasses import replace

import numpy as np

from fbench.pipelines.sensors.image.objects import Spots, focal_scale, outlines
from fbench.pipelines.sensors.image.stage import ImageObservations, InImages, by_points
from fbench.pipelines.sensors.lidar.clusters import LidarView
from fbench.pipelines.sensors.stereo.stage import ObjectParams, StereoStage, detect, find_unmeasured, rate_exactness
from fbench.replay.contracts.params import StageClock
from fbench.replay.data.arrays import Bool, Float64
from fbench.replay.data.boxes import Source
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import project_body

_OWN = 0.5  # An object stays if LiDARs measured nothing in the directions of more than this share of its points
_STEREO_MARGIN_PX = 4.0
"""Outlines are wider than the points of stereo by so much on each side [px], at a focal length of 400 px: half a cell.
"""


class StereoInImages:
    """Vehicles in the points of a stereo pair, outlined in images by these points."""

    def __init__(self, rig: Rig, cameras: tuple[str, ...], stage: StereoStage) -> None:
        self._rig, self._cameras, self._stage, self._params = rig, cameras, stage, ObjectParams()
        self.pair = stage.pair.left, stage.pair.right  # Cameras that give depth

    def view(self, frame: Frame, clock: StageClock, faults: list[Fault], measured: Float64 | None) -> InImages:
        """Detect in one frame what LiDARs, with all their points (K, 3) in body coordinates [m], measured nothing of;
        `None`: none delivered. A corrupt image is a fault and counts as missing.
        """
        stage, view = self._stage, self._stage.view(frame, clock, faults)
        if not len(view.xyz):
            return InImages(noisy=self.pair if view.is_off else ())
        with clock.stage("detect.stereo"):
            found = detect(view.xyz, stage.eye_m, stage.focal_baseline, self._params)
            if measured is not None and len(found.boxes):
                found = _drop_measured(found, find_unmeasured(found.xyz, measured, stage.eye_m))
            return InImages({name: self._outline(name, found) for name in self._cameras})

    def _outline(self, camera: str, found: LidarView) -> ImageObservations:
        boxes, member = found.boxes, found.cluster >= 0
        if boxes.score is None or not len(boxes):
            return ImageObservations.none()
        xyz, cluster = found.xyz[member], found.cluster[member]
        first = np.append(np.flatnonzero(np.diff(cluster, prepend=-1)), len(cluster))
        margin = _STEREO_MARGIN_PX * focal_scale(self._rig.cameras[camera])
        outline = outlines(self._rig, camera, found.plane, xyz, first, margin)
        depth = np.minimum.reduceat(project_body(self._rig, camera, xyz)[1], first[:-1])
        unknown = np.full(len(boxes), np.nan)
        spots = Spots(outline, boxes.score, boxes.center_m, boxes.size_lwh_m, depth, unknown, np.diff(first))
        seen, sigma_px = by_points(spots, Source.S), self._params.cluster.sigma_px
        # The error of Z = f B / d is Z^2 / (f B) times that of d.
        std = np.hypot(seen.depth_std, seen.depth_m * sigma_px / self._stage.focal_baseline)
        exactness = rate_exactness(seen.depth_m, self._stage.focal_baseline, sigma_px)
        return replace(seen, depth_std=std, exactness=exactness)


def _drop_measured(found: LidarView, is_own: Bool) -> LidarView:
    """Leave out objects of which LiDARs measured most, given which points (N,) lie where they measured nothing."""
    member = found.cluster >= 0
    num = np.bincount(found.cluster[member], minlength=len(found.boxes))
    kept = np.bincount(found.cluster[member], weights=is_own[member], minlength=len(found.boxes)) > _OWN * num
    number = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)[found.cluster]
    rows = np.flatnonzero(number >= 0)
    return replace(found, xyz=found.xyz[rows], cluster=number[rows], boxes=found.boxes[kept])
