"""Tracks boxes in images, each camera for itself."""

from dataclasses import dataclass, replace

import numpy as np

from fbench.pipelines.checks import require_between
from fbench.pipelines.tracking import kalman
from fbench.pipelines.tracking.association import associate
from fbench.pipelines.tracking.kalman import States
from fbench.pipelines.tracking.tracks import (
    Tracks,
    first_tracks,
    joined,
    measured_tracks,
    rivals,
    seconds_since,
    surviving,
)
from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes2D
from fbench.replay.geometry.boxes import iou_2d

MIN_STD = 1e-6
MIN_SHAPE = 1e-3
"""Least area [px^2] and aspect ratio that a prediction can shrink to."""


@dataclass(frozen=True)
class Tracker2DParams:
    """Parameters of the 2D tracker. Noise is relative to a box's size: the side of a square of its area."""

    min_iou: float = 0.1
    """Detections that overlap a track's prediction less than this don't belong to it."""
    max_missed: int = 2
    """A track ends when more steps than this in a row didn't measure it, or one before it had `min_hits`."""
    max_coast_s: float = 0.5
    """A track that nothing measured for longer than this [s] is not shown, since its prediction is too uncertain."""
    min_hits: int = 2
    """Measurements before a track is shown; in the first steps after a reset fewer are enough."""
    measured_std: float = 0.05
    """Standard deviation of a measured position, as a share of the box's size."""
    rate_std: float = 2.0
    """Standard deviation of a new track's rate of change, in box sizes a second."""
    drift_std: float = 0.5
    """Change of the rates within one second, standard deviation in box sizes a second."""

    def __post_init__(self) -> None:
        require_between("tracking.min_iou", self.min_iou, 0.0, 1.0)
        for name in ("max_missed", "max_coast_s", "min_hits", "rate_std", "drift_std"):
            require_between(f"tracking.{name}", getattr(self, name), 0)
        require_between("tracking.measured_std", self.measured_std, MIN_STD)


class Tracker2D:
    """Linear Kalman filter with constant velocity per box, state (x, y, s, r, vx, vy, vs, vr) (thesis, Tracking).

    s is the box's area and r its width by its height. Detections join tracks of the same camera by IoU. Distance and
    range rate of a track are those measured last; between measurements distance moves by range rate times time.
    """

    def __init__(self, params: Tracker2DParams) -> None:
        self._params = params
        self._next_id = 1
        self.reset()

    def reset(self) -> None:
        """End all tracks; their ids are not used again."""
        self._tracks: Tracks[Boxes2D] | None = None
        self._stamp_ns = 0
        self._steps = 0

    def step(self, boxes: Boxes2D, stamp_ns: int) -> Boxes2D:
        """Take the detections of all cameras at `stamp_ns`; returns the tracks, also those only predicted.

        Fields of the result are the same in every step; `label` is there where the detections have it.

        Raises:
            DataError: where `stamp_ns` isn't later than at the last step since the reset.
        """
        detections = _complete(boxes)
        if self._tracks is None:
            tracks = self._begin(detections, stamp_ns)
        else:
            tracks = self._follow(self._tracks, detections, stamp_ns)
        self._tracks, self._stamp_ns, self._steps = tracks, stamp_ns, self._steps + 1
        return self._shown(tracks, with_label=boxes.label is not None)

    def _begin(self, detections: Boxes2D, stamp_ns: int) -> Tracks[Boxes2D]:
        measured = _measure(detections)
        unit = _unit(measured)
        p = self._params
        states = kalman.begin(measured, np.zeros_like(measured), p.measured_std * unit, p.rate_std * unit)
        first_id, self._next_id = self._next_id, self._next_id + len(detections)
        return first_tracks(detections, states, first_id, stamp_ns)

    def _follow(self, tracks: Tracks[Boxes2D], detections: Boxes2D, stamp_ns: int) -> Tracks[Boxes2D]:
        tracks = self._predicted(tracks, seconds_since(self._stamp_ns, stamp_ns))
        rows, columns = associate(_similarity(tracks, detections), self._params.min_iou)
        measured = _measure(detections[columns])
        states = kalman.update(tracks.states.rows(rows), measured, self._params.measured_std * _unit(measured))
        ranged = _keep_range(tracks.last[rows], detections[columns])
        tracks = measured_tracks(tracks, rows, ranged, states, stamp_ns)
        new = np.ones(len(detections), bool)
        new[columns] = False
        alive = tracks.rows(surviving(tracks, self._params.min_hits, self._params.max_missed))
        return joined(alive, self._begin(detections[new], stamp_ns))

    def _predicted(self, tracks: Tracks[Boxes2D], dt_s: float) -> Tracks[Boxes2D]:
        moved = kalman.predict(tracks.states, dt_s, self._params.drift_std * _unit(tracks.states.mean[:, :4]))
        shaped = _with_valid_shape(moved, tracks.states)
        rate = tracks.last.range_rate_mps
        step = np.zeros(len(tracks)) if rate is None else np.nan_to_num(rate) * dt_s
        distance = None if tracks.last.distance_m is None else tracks.last.distance_m + step
        return replace(tracks, states=shaped, last=replace(tracks.last, distance_m=distance))

    def _shown(self, tracks: Tracks[Boxes2D], *, with_label: bool) -> Boxes2D:
        p = self._params
        coasted_s = (self._stamp_ns - tracks.updated_ns) * 1e-9
        tracks = tracks.rows((tracks.hits >= min(p.min_hits, self._steps)) & (coasted_s <= p.max_coast_s))
        return replace(
            tracks.last,
            xyxy_px=_boxes(tracks.states.mean),
            label=tracks.labels() if with_label else None,
            track_id=tracks.track_id,
            predicted=tracks.missed > 0,
        )


def _complete(boxes: Boxes2D) -> Boxes2D:
    """The fields that tracks carry, present in any case."""
    num = len(boxes)
    unknown = np.full(num, np.nan)
    return Boxes2D(
        camera=boxes.camera,
        xyxy_px=boxes.xyxy_px,
        label=np.full(num, "other") if boxes.label is None else boxes.label,
        score=np.ones(num) if boxes.score is None else boxes.score,
        distance_m=unknown if boxes.distance_m is None else boxes.distance_m,
        range_rate_mps=unknown if boxes.range_rate_mps is None else boxes.range_rate_mps,
        sources=np.zeros(num, np.uint8) if boxes.sources is None else boxes.sources,
    )


def _measure(boxes: Boxes2D) -> Float64:
    """Centre x, y, area s and aspect ratio r (N, 4)."""
    centre = (boxes.xyxy_px[:, :2] + boxes.xyxy_px[:, 2:]) / 2
    width, height = np.maximum(boxes.xyxy_px[:, 2:] - boxes.xyxy_px[:, :2], MIN_SHAPE).T
    return np.stack([centre[:, 0], centre[:, 1], width * height, width / height], axis=1)


def _boxes(mean: Float64) -> Float64:
    """Left, top, right, bottom (N, 4) of states."""
    x, y, area, aspect = mean[:, :4].T
    half = np.stack([np.sqrt(area * aspect), np.sqrt(area / aspect)], axis=1) / 2
    centre = np.stack([x, y], axis=1)
    return np.concatenate([centre - half, centre + half], axis=1)


def _unit(measured: Float64) -> Float64:
    """What one box size means for each component (N, 4): a side, a side, the area, the aspect ratio."""
    _, _, area, aspect = measured.T
    side = np.sqrt(area)
    return np.stack([side, side, area, aspect], axis=1)


def _similarity(tracks: Tracks[Boxes2D], detections: Boxes2D) -> Float64:
    iou = iou_2d(_boxes(tracks.states.mean), detections.xyxy_px)
    apart = rivals(tracks.last.label, detections.label, iou.shape)
    apart |= tracks.last.camera[:, None] != detections.camera[None, :]
    return np.where(apart, 0.0, iou)


def _with_valid_shape(moved: States, before: States) -> States:
    """Where a prediction would have no area or aspect, keep those of before and forget their rates."""
    mean = moved.mean.copy()
    for shape in (2, 3):
        bad = mean[:, shape] < MIN_SHAPE
        mean[bad, shape] = np.maximum(before.mean[bad, shape], MIN_SHAPE)
        mean[bad, shape + 4] = 0.0
    return States(mean, moved.cov)


def _keep_range(before: Boxes2D, now: Boxes2D) -> Boxes2D:
    """Where nothing measured distance or range rate now, keep what the track had."""
    kept = {
        name: np.where(np.isnan(new), old, new)
        for name, old, new in (
            ("distance_m", before.distance_m, now.distance_m),
            ("range_rate_mps", before.range_rate_mps, now.range_rate_mps),
        )
        if old is not None and new is not None
    }
    return replace(now, **kept)
