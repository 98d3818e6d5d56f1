"""Which cameras a run is scored in, and whether boxes are projected into them."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.objects import Space
from fbench.metrics.runs.view import Labelled
from fbench.replay.boxes import Boxes2D, Boxes3D
from fbench.replay.data import Boxes
from fbench.replay.errors import MetricError
from fbench.replay.geometry.camera import not_projectable
from fbench.replay.log_keys import CAMERA0
from fbench.replay.sensor_choice import chosen_sensors
from fbench.replay.store import Run

_KITTI_CAMERA = "image_02"
"""Whose image KITTI's labels are in."""


@dataclass(frozen=True, eq=False)
class View:
    """Frames with truth, and the images in which they are seen."""

    labelled: Labelled
    space: Space
    cameras: tuple[str, ...]
    """In images each is a stream of its own; in space at most one: rules about heights and regions are about one
    image."""
    is_recorded: bool
    """Whether truth has rectangles of its own."""

    @property
    def run(self) -> Run:
        """The run."""
        return self.labelled.run


def view_of(run: Run, boxes: Boxes, space: Space) -> View:
    """Return how results are scored against the truth of their run.

    Raises:
        MetricError: where there is no such truth (GT001), no camera, or one into which nothing can be projected.
    """
    spaces = {kind for frame in run.frames for kind in frame.truth_spaces.split()}
    is_recorded = "2d" in spaces
    wanted = "3d" if space == "3d" or not is_recorded else "2d"
    if wanted not in spaces:
        what = "truth in 3D" if spaces else "truth"
        raise MetricError(f"{run.folder}: no {what}, so there is nothing to score", "GT001")
    labelled = Labelled.of(run, wanted)
    cameras = _cameras(run, boxes, is_recorded)
    bent = _bent(run, cameras) if isinstance(boxes, Boxes3D) or not is_recorded else ""
    if space == "2d":
        if not cameras:
            raise MetricError(f"{run.folder}: no camera, in whose image boxes could be scored")
        if bent:
            raise MetricError(f"{run.folder}: lens distortion of '{bent}' isn't modelled, so boxes can't be projected")
    elif len(cameras) > 1 or bent:
        cameras = ()
    return View(labelled, space, cameras, is_recorded)


def _cameras(run: Run, boxes: Boxes, is_recorded: bool) -> tuple[str, ...]:
    """KITTI's own camera, else those of the truth in images, else all; of results in images those that the pipeline
    got.
    """
    rig, owners = run.manifest.rig, set(run.manifest.rig.cameras)
    if is_recorded:
        truth = run.truth_table("2d").boxes
        own = set(np.unique(truth.camera).tolist()) if isinstance(truth, Boxes2D) else set()
        owners = own or owners
    if run.manifest.log.metadata.get(CAMERA0) is not None and _KITTI_CAMERA in owners:
        return (_KITTI_CAMERA,)
    if isinstance(boxes, Boxes2D):
        names = rig.sensors("camera", "lidar", "radar")
        owners -= set(names) - set(chosen_sensors(names, run.manifest.frames.sensors))
    return tuple(sorted(owners))


def _bent(run: Run, cameras: tuple[str, ...]) -> str:
    """The first camera whose lens isn't modelled, or that the rig doesn't know."""
    known = run.manifest.rig.cameras
    return next((name for name in cameras if name not in known or not_projectable(known[name]) is not None), "")
