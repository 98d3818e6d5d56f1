"""Scoring in 3D: centres in the ground plane."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fbench.metrics.items import Items, canonical, make_items
from fbench.replay.arrays import Bool, Float64
from fbench.replay.boxes import Boxes3D, finite
from fbench.replay.data import Boxes, Rig
from fbench.replay.errors import MetricError
from fbench.replay.geometry.boxes import distance_bev
from fbench.replay.geometry.camera import in_image, not_projectable, project_body
from fbench.replay.scores import ScoreOptions
from fbench.replay.store import Run


@dataclass(frozen=True, eq=False)
class GroundSpace:
    """3D boxes match by the distance of their centres in the ground plane, as in nuScenes."""

    rig: Rig
    options: ScoreOptions
    reason: str | None = None
    unit: str = "m"
    shared_excuse: bool = False
    """One truth box that needn't be found excuses one estimate."""

    @property
    def matching(self) -> str:
        """How boxes match and which of them count."""
        view = ", in view" if self.options.in_view and self._cameras else ""
        return f"bev {self.options.distance_m:g} m, within {self.options.range_m:g} m{view}"

    @property
    def threshold(self) -> float:
        """Similarity from which on boxes match."""
        return -self.options.distance_m

    @property
    def _cameras(self) -> tuple[str, ...]:
        """Cameras whose view is known: those whose lens distortion is modelled."""
        return tuple(name for name, camera in sorted(self.rig.cameras.items()) if not_projectable(camera) is None)

    def truth(self, run: Run, index: int) -> Boxes | None:
        """Truth of frame `index`."""
        return run.truth3d(index)

    def split(self, truth: Boxes, estimates: Boxes) -> Iterator[tuple[str, Items, Items]]:
        """Yield one pair of items: the ground plane is one scene."""
        yield "", self._items(canonical(truth)), self._items(canonical(estimates))

    def similarity(self, truth: Items, estimates: Items) -> Float64:
        """Negated distance (N, M) [m]."""
        return -distance_bev(truth.place, estimates.place)

    def excuse(self, truth: Items, estimates: Items) -> Float64:
        """Negated distance (N, M) [m] to truth that needn't be found."""
        return self.similarity(truth, estimates)

    def measure(self, similarity: float) -> float:
        """Distance [m] of a pair."""
        return abs(similarity)

    def _items(self, boxes: Boxes) -> Items:
        if not isinstance(boxes, Boxes3D):
            raise MetricError("2D boxes can't be scored in 3D")
        sane, scored = finite(boxes)
        centers = np.where(sane[:, None], boxes.center_m, 0.0)
        inside = within(centers, self.options.range_m)
        if self.options.in_view and self._cameras:
            inside &= np.any([in_view(self.rig, name, centers) for name in self._cameras], axis=0)
        return make_items(boxes, centers[:, :2], sane & scored, inside)


def within(centers: Float64, range_m: float) -> Bool:
    """Tell which points (N, 3) in body coordinates are at most `range_m` from the body's origin in the ground plane."""
    near: Bool = np.hypot(centers[:, 0], centers[:, 1]) <= range_m
    return near


def in_view(rig: Rig, camera: str, centers: Float64) -> Bool:
    """Tell which points (N, 3) in body coordinates project into the image of a camera.

    Raises:
        LogError: where the camera's distortion isn't modelled.
    """
    return in_image(rig.cameras[camera], project_body(rig, camera, centers)[0])
