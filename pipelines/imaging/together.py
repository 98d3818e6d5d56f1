"""Fusion in all images of a rig."""

from collections.abc import Mapping, Sequence

import numpy as np

from fbench.pipelines.camera.detector import CameraDetections
from fbench.pipelines.imaging.fuse import ImageView, fuse
from fbench.pipelines.imaging.fusion_params import ImageFusionParams
from fbench.pipelines.imaging.sensors import InImages
from fbench.pipelines.imaging.sightings import Sightings, by_camera
from fbench.pipelines.imaging.trust import CameraTrust
from fbench.replay.boxes import Boxes2D, concatenate
from fbench.replay.data import Rig, Source


class ImageFusion:
    """Merges what the sensors see in each image, and learns from it how well the cameras see."""

    def __init__(self, rig: Rig, cameras: Sequence[str], params: ImageFusionParams) -> None:
        self._rig, self._cameras, self._params, self._trust = rig, cameras, params, CameraTrust()

    def reset(self) -> None:
        """Forget how well the cameras see."""
        self._trust.reset()

    def merge(self, looked: Mapping[str, CameraDetections], lidar: InImages, radar: InImages) -> Boxes2D:
        """Merge one frame; `looked` holds the cameras that worked. Any number of boxes has the same fields."""
        params, trust = self._params, self._trust.share
        views = [_view(self._rig, name, looked.get(name), lidar, radar) for name in self._cameras]
        every = concatenate([fuse(view, params, trust) for view in views])
        found = every if every.score is None else every[every.score >= params.min_score]
        self._trust.learn(found[np.isin(found.camera, sorted(looked))])
        return found


def _view(rig: Rig, camera: str, found: CameraDetections | None, lidar: InImages, radar: InImages) -> ImageView:
    kinds = {Source.L: lidar, Source.R: radar}
    parts = [view.seen[camera] for view in kinds.values() if camera in view.seen]
    if found is not None:
        parts.append(by_camera(found, rig.cameras[camera]))
    return ImageView(
        rig=rig,
        camera=camera,
        seen=Sightings.joined(parts),
        looked=found is not None,
        points={kind: view.points[camera] for kind, view in kinds.items() if camera in view.points},
        rays={kind: view.rays[camera] for kind, view in kinds.items() if camera in view.rays},
    )
