"""Observations of cameras, LiDARs and radars in one image, in one form."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.pipelines.fusion.reliability import log_odds
from fbench.pipelines.fusion.sizes import LONG_M, SIZES
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.image.objects import Spots
from fbench.pipelines.sensors.rows import Rows
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, Text
from fbench.replay.data.boxes import Boxes3D, Source
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.geometry.camera import project_body, project_boxes
from fbench.replay.geometry.iou import corners

SURE = 0.5  # A camera alone reports what it believes so far


def relative(score: Float64, min_score: float) -> Float64:
    """Turn the scores (N,) of a camera's boxes into probabilities, `SURE` at the score from which on it reports them.

    Detectors mean different things by a score. The ratio of odds to those of `min_score`, which weights bring with
    them, is taken to mean the same for all.
    """
    return np.asarray(1 / (1 + np.exp(log_odds(min_score) - log_odds(score))), np.float64)


_GUESS_STD = 0.25
_EDGE_PX = 3.0
_MEASURED_STD, _MEASURED_STD_M = 0.04, 1.2  # Error of measured depths, as a share of the depth and [m]


@dataclass(frozen=True, eq=False)
class Sightings(Rows):
    """N boxes in one image, of one or several kinds of sensors."""

    source: Array  # (N,) uint8, one bit of `Source`
    xyxy_px: Float64  # (N, 4) left, top, right, bottom [px]
    score: Float64
    """(N,) 0 to 1: by cameras how likely each is, from `SURE` on those that a camera alone reports; by others how much
    it looks like a vehicle.
    """
    label: Text  # (N,)
    depth_m: Float64  # (N,) of the near side along the optical axis [m]; NaN where unknown
    depth_std: Float64  # (N,) relative error of the depth
    distance_m: Float64  # (N,) from the body's origin to the middle [m]; NaN where unknown
    rate_mps: Float64  # (N,) change of the distance [m/s], positive when receding; NaN where unknown
    spot: Int64  # (N,) row of the `Spots` that it is; -1: none
    upright: Bool  # (N,) whether its upper and lower edge are known; sparse radars don't tell heights

    def sort(self) -> "Sightings":
        """Sort by source, falling score, then place, so that the order in which they are given never matters."""
        return self[np.lexsort((*self.xyxy_px.T[::-1], -self.score, self.source))]

    @property
    def weak(self) -> Bool:
        """(N,) boxes of cameras that count only where another sensor confirms them."""
        return np.asarray((self.source == int(Source.C)) & (self.score < SURE), np.bool_)

    @classmethod
    def none(cls) -> "Sightings":
        """Return no boxes."""
        none = np.zeros(0)
        return cls(
            none.astype(np.uint8), np.zeros((0, 4)), none, none.astype("U1"), none, none, none, none, _no_spot(0),
            none > 0,
        )  # fmt: skip

    @classmethod
    def join(cls, parts: Sequence["Sightings"]) -> "Sightings":
        """Put several into one, in order."""
        return super().join([*parts, cls.none()]).sort()


def by_camera(found: CameraDetections, camera: CameraModel) -> Sightings:
    """What a camera sees, and at which depth an object with its label would be as tall as its box; NaN for boxes that
    the upper or lower border cuts off.
    """
    num, (_, top, _, bottom) = len(found), found.xyxy_px.T
    whole = (top > _EDGE_PX) & (bottom < camera.size_wh[1] - 1 - _EDGE_PX)
    typical = [SIZES.get(label) for label in found.label.tolist()]
    height = np.array([np.nan if size is None else size.image_height_m for size in typical], np.float64)
    depth = np.where(whole, camera.K[1, 1] * height / np.maximum(bottom - top, 1.0), np.nan)
    unknown = np.full(num, np.nan)
    source = np.full(num, int(Source.C), np.uint8)
    std = np.full(num, _GUESS_STD)
    score = relative(found.score, found.min_score)
    return Sightings(source, found.xyxy_px, score, found.label, depth, std, unknown, unknown, _no_spot(num),
                     np.ones(num, np.bool_))  # fmt: skip


def by_points(spots: Spots, source: Source) -> Sightings:
    """What LiDARs or radars see in the image."""
    rows = np.flatnonzero(np.isfinite(spots.xyxy_px).all(axis=1) & (spots.score > 0))
    spots = spots[rows]
    label = np.where(spots.size_lwh_m[:, 0] > LONG_M, "truck", "car")
    sources = np.full(len(spots), int(source), np.uint8)
    std = _compute_std(spots.depth_m)
    return Sightings(
        sources, spots.xyxy_px, spots.score, label, spots.depth_m, std, spots.distance_m, spots.rate_mps, rows,
        np.ones(len(rows), np.bool_),
    )  # fmt: skip


def by_boxes(rig: Rig, camera: str, boxes: Boxes3D, rate_mps: Float64, source: Source) -> Sightings:
    """What boxes in space (N), with their changes of distance (N,) [m/s], look like in the image."""
    score = np.zeros(len(boxes)) if boxes.score is None else boxes.score
    outline, seen = project_boxes(rig, camera, boxes)
    rows = np.flatnonzero(seen & (score > 0))
    boxes, num = boxes[rows], len(rows)
    depths = project_body(rig, camera, corners(boxes).reshape(-1, 3))[1].reshape(-1, 8)
    depth = np.maximum(depths.min(axis=1, initial=np.inf), 0.5) if num else np.zeros(0)
    distance = np.sqrt((boxes.center_m**2).sum(axis=1))
    label = np.where(boxes.size_lwh_m[:, 0] > LONG_M, "truck", "car") if boxes.label is None else boxes.label
    sources = np.full(num, int(source), np.uint8)
    return Sightings(
        sources, outline[rows], score[rows], label, depth, _compute_std(depth), distance, rate_mps[rows],
        _no_spot(num), np.full(num, source != Source.R),
    )  # fmt: skip


def _no_spot(num: int) -> Int64:
    return np.full(num, -1)


def _compute_std(depth_m: Float64) -> Float64:
    return np.asarray(_MEASURED_STD + _MEASURED_STD_M / np.maximum(depth_m, 1.0), np.float64)
