"""Scoring in images: rectangles of each camera, recorded or projected from 3D."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fbench.metrics.ground import in_view, within
from fbench.metrics.items import Items, canonical, make_items
from fbench.replay.arrays import Bool, Float64
from fbench.replay.boxes import Boxes2D, Boxes3D, finite
from fbench.replay.data import Boxes, Rig
from fbench.replay.geometry.boxes import iou_2d
from fbench.replay.geometry.camera import not_projectable, project_boxes
from fbench.replay.scores import ScoreOptions
from fbench.replay.sensor_choice import chosen_sensors
from fbench.replay.store import Run


@dataclass(frozen=True, eq=False)
class ImageSpace:
    """Rectangles match by their intersection over union, each camera apart from the others."""

    rig: Rig
    options: ScoreOptions
    cameras: tuple[str, ...]
    derived: bool
    """Whether truth is 3D truth, projected."""
    ranged: bool
    """Whether the distance of truth is known; where it isn't, boxes of any distance count."""
    projects: bool
    """Whether truth or estimates are 3D and must be projected."""
    unit: str = "iou"
    shared_excuse: bool = True
    """One truth box that needn't be found excuses all estimates in it."""

    @classmethod
    def of(cls, run: Run, options: ScoreOptions) -> "ImageSpace":
        """Use the 2D truth of the run's log where it has any, with the cameras that it names; else 3D truth.

        A pipeline that works in images is judged in those of the cameras that it got.
        """
        recorded = [t for t in (run.truth2d(frame.index) for frame in run.frames) if t is not None]
        rig = run.manifest.rig
        named = {str(name) for truth in recorded for name in np.unique(truth.camera)}
        ranged = any(t.distance_m is not None and bool(np.isfinite(t.distance_m).any()) for t in recorded)
        derived = not recorded
        projects = derived or isinstance(run.detections.boxes, Boxes3D)
        cameras = named or set(rig.cameras)
        if isinstance(run.detections.boxes, Boxes2D):  # in images that it didn't get a pipeline can find nothing
            names = rig.sensors("camera", "lidar", "radar")
            cameras -= set(names) - set(chosen_sensors(names, run.manifest.frames.sensors))
        return cls(rig, options, tuple(sorted(cameras)), derived, ranged or derived, projects)

    @property
    def reason(self) -> str | None:
        """Why nothing can be scored here."""
        if not self.cameras:
            return "no cameras"
        known = [(name, self.rig.cameras[name]) for name in self.cameras if name in self.rig.cameras]
        bent = [name for name, camera in known if not_projectable(camera) is not None]
        return f"lens distortion of '{bent[0]}' isn't modelled" if self.projects and bent else None

    @property
    def matching(self) -> str:
        """How boxes match and which of them count."""
        derived = ", truth projected from 3D" if self.derived else ""
        near = f", within {self.options.range_m:g} m" if self.ranged else ""
        view = ", in view" if self.derived and self.options.in_view else ""
        return f"iou {self.options.iou:g}{derived}{near}{view}"

    @property
    def threshold(self) -> float:
        """Similarity from which on boxes match."""
        return self.options.iou

    def truth(self, run: Run, index: int) -> Boxes | None:
        """Truth of frame `index`."""
        return run.truth3d(index) if self.derived else run.truth2d(index)

    def split(self, truth: Boxes, estimates: Boxes) -> Iterator[tuple[str, Items, Items]]:
        """Yield one pair of items a camera."""
        truth, estimates = canonical(truth), canonical(estimates)
        for camera in self.cameras:
            yield camera, self._items(camera, truth), self._items(camera, estimates)

    def similarity(self, truth: Items, estimates: Items) -> Float64:
        """Intersection over union (N, M)."""
        return iou_2d(truth.place, estimates.place)

    def excuse(self, truth: Items, estimates: Items) -> Float64:
        """Share (N, M) of an estimate that lies in truth that needn't be found.

        As KITTI does for its regions: they are larger than what is in them, and hold any number of objects.
        """
        low = np.maximum(truth.place[:, None, :2], estimates.place[None, :, :2])
        high = np.minimum(truth.place[:, None, 2:], estimates.place[None, :, 2:])
        common = np.prod(np.clip(high - low, 0, None), axis=2)
        area = np.prod(np.clip(estimates.place[:, 2:] - estimates.place[:, :2], 0, None), axis=1)
        share: Float64 = np.divide(common, area[None, :], out=np.zeros_like(common), where=area[None, :] > 0)
        return share

    def measure(self, similarity: float) -> float:
        """Intersection over union of a pair."""
        return similarity

    def _items(self, camera: str, boxes: Boxes) -> Items:
        return self._recorded(camera, boxes) if isinstance(boxes, Boxes2D) else self._projected(camera, boxes)

    def _recorded(self, camera: str, boxes: Boxes2D) -> Items:
        boxes = boxes[boxes.camera == camera]
        sane, scored = finite(boxes)
        inside = np.ones(len(boxes), bool)
        if self.ranged and boxes.distance_m is not None:
            inside = ~(boxes.distance_m > self.options.range_m)
        return make_items(boxes, boxes.xyxy_px, sane & scored, inside)

    def _projected(self, camera: str, boxes: Boxes3D) -> Items:
        sane, scored = finite(boxes)
        rectangles, seen = np.zeros((len(boxes), 4)), np.zeros(len(boxes), bool)
        rectangles[sane], seen[sane] = project_boxes(self.rig, camera, boxes[sane])
        inside = self._inside(camera, np.where(sane[:, None], boxes.center_m, 0.0))
        # A box that isn't finite can't be projected; it counts once, in the first image.
        rows = seen | (~sane & (camera == self.cameras[0]))
        return make_items(boxes, rectangles, sane & scored, inside)[rows]

    def _inside(self, camera: str, centers: Float64) -> Bool:
        inside = within(centers, self.options.range_m) if self.ranged else np.ones(len(centers), bool)
        if self.derived and self.options.in_view:
            inside &= in_view(self.rig, camera, centers)
        return inside
