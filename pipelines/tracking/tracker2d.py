"""Tracks boxes in images, each camera for itself."""

from dataclasses import replace

import numpy as np

from fbench.pipelines.tracking import association as like
from fbench.pipelines.tracking import kalman
from fbench.pipelines.tracking import tracks as smoothing
from fbench.pipelines.tracking.association import associate_weak_last, canonical
from fbench.pipelines.tracking.kalman import States
from fbench.pipelines.tracking.params import Tracker2DParams
from fbench.pipelines.tracking.tracks import (
    Columns,
    Tracks,
    first_tracks,
    join_tracks,
    measured_tracks,
    rivals,
    rows,
    seconds_since,
    selected,
    shown,
    surviving,
)
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes2D

__all__ = ["Tracker2D", "Tracker2DParams"]

MIN_SHAPE = 1e-3
"""Least area [px^2] and aspect ratio that a prediction can shrink to."""


class Tracker2D:
    """Linear Kalman filter with constant velocity per box, state (x, y, s, r, vx, vy, vs, vr) (thesis, Tracking).

    s is the box's area and r its width by its height. Detections join tracks of the same camera by IoU. Distance and
    range rate of a track are those measured last; between measurements distance moves by range rate times time.

    Ids go by the order of detections in which tracks begin; with `any_order` detections are sorted by their content
    first, and those that aren't finite are left out.
    """

    def __init__(self, params: Tracker2DParams, *, any_order: bool = False) -> None:
        self._params = params
        self._any_order = any_order
        self._next_id = 1
        self.reset()

    def reset(self) -> None:
        """End all tracks; their ids are not used again."""
        self._tracks: Tracks | None = None
        self._stamp_ns = 0
        self._steps = 0
        self._with_label = False

    def step(self, boxes: Boxes2D, stamp_ns: int) -> Boxes2D:
        """Take the detections of all cameras at `stamp_ns`; returns the tracks, also those only predicted.

        Fields of the result are the same in every step; `label` is there where the detections have it.

        Raises:
            DataError: where `stamp_ns` isn't later than at the last step since the reset.
        """
        detections = _complete(boxes)
        if self._any_order:
            detections = canonical(detections, "xyxy_px")
        if self._tracks is None:
            tracks = self._begin(rows(detections, ~self._weak(detections)), stamp_ns)
        else:
            tracks = self._follow(self._predicted(self._tracks, stamp_ns), detections, stamp_ns)
        self._tracks, self._stamp_ns, self._steps = tracks, stamp_ns, self._steps + 1
        self._with_label = boxes.label is not None or (not len(boxes) and self._with_label)
        return self._shown(tracks)

    def predict(self, stamp_ns: int) -> Boxes2D:
        """Return where the tracks are at an instant at which nothing was looked for, so that none missed anything.

        Raises:
            DataError: see `step`.
        """
        if self._tracks is None:
            return self._shown(self._begin(_complete(Boxes2D.empty()), stamp_ns))
        self._tracks = self._predicted(self._tracks, stamp_ns)
        self._stamp_ns = stamp_ns
        return self._shown(self._tracks)

    def _weak(self, detections: Columns) -> Bool:
        return np.asarray(detections["score"] < self._params.weak_score, np.bool_)

    def _begin(self, detections: Columns, stamp_ns: int) -> Tracks:
        measured = _measure(detections)
        unit = _unit(measured)
        p = self._params
        states = kalman.begin(measured, np.zeros_like(measured), p.measured_std * unit, p.rate_std * unit)
        first_id, self._next_id = self._next_id, self._next_id + len(measured)
        return first_tracks(detections, states, first_id, stamp_ns)

    def _follow(self, tracks: Tracks, detections: Columns, stamp_ns: int) -> Tracks:
        p = self._params
        weak = self._weak(detections)
        at, columns = associate_weak_last(*self._similarity(tracks, detections), weak)
        found = rows(detections, columns)
        measured = _measure(found)
        states = kalman.update(tracks.states.rows(at), measured, p.measured_std * _unit(measured))
        tracks = measured_tracks(tracks, at, self._carried(tracks, at, found), states, stamp_ns)
        new = ~weak
        new[columns] = False
        alive = selected(tracks, surviving(tracks, p.min_hits, p.max_missed))
        return join_tracks(alive, self._begin(rows(detections, new), stamp_ns)) if new.any() else alive

    def _predicted(self, tracks: Tracks, stamp_ns: int) -> Tracks:
        dt_s = seconds_since(self._stamp_ns, stamp_ns)
        moved = kalman.predict(tracks.states, dt_s, self._params.drift_std * _unit(tracks.states.place))
        shaped = _with_valid_shape(moved, tracks.states)
        rate = tracks.last["range_rate_mps"]
        distance = tracks.last["distance_m"] + np.where(np.isnan(rate), 0.0, rate) * dt_s
        return replace(tracks, states=shaped, last=tracks.last | {"distance_m": distance})

    def _similarity(self, tracks: Tracks, detections: Columns) -> tuple[Float64, float]:
        """How well tracks and detections fit (T, M), and how well a pair must."""
        similarity, least = self._likeness(tracks, detections)
        similarity[rivals(tracks.last["label"], detections["label"])] = 0.0
        one, other = tracks.last["camera"], detections["camera"]
        if len({*one.tolist(), *other.tolist()}) > 1:
            similarity[one[:, None] != other[None, :]] = 0.0
        return similarity, least

    def _likeness(self, tracks: Tracks, detections: Columns) -> tuple[Float64, float]:
        p = self._params
        if p.association == "mahalanobis":
            measured = _measure(detections)
            std = p.measured_std * _unit(measured)
            return like.mahalanobis_nearness(tracks.states, measured, std, p.max_mahalanobis), 0.0
        boxes = _boxes(tracks.states.place)
        if p.association == "giou":
            return like.as_similarity(like.giou_2d(boxes, detections["xyxy_px"])), (p.min_giou + 1.0) / 2.0
        return like.image_iou(boxes, detections["xyxy_px"]), p.min_iou

    def _carried(self, tracks: Tracks, at: Int64, found: Columns) -> Columns:
        """What the tracks `at` carry on; where nothing measured distance or range rate now, what they had."""
        kept: Columns = {}
        for name in ("distance_m", "range_rate_mps"):
            kept[name] = np.where(np.isnan(found[name]), tracks.last[name][at], found[name])
        if self._params.score == "mean":
            kept["score"] = smoothing.mean_of(
                tracks.last["score"][at], found["score"], smoothing.weight(tracks.hits[at] + 1, 0.0)
            )
        return found | kept

    def _shown(self, tracks: Tracks) -> Boxes2D:
        p = self._params
        tracks = selected(tracks, shown(tracks, self._stamp_ns, self._steps, p))
        predicted = np.asarray(tracks.updated_ns < self._stamp_ns, np.bool_)
        found: Columns = tracks.last | {
            "xyxy_px": _boxes(tracks.states.place),
            "score": smoothing.coasted_score(tracks.last["score"], predicted, p.predicted_share),
            "track_id": tracks.track_id,
            "predicted": predicted,
        }
        found["label"] = tracks.labels()
        if not self._with_label:
            del found["label"]
        return Boxes2D(**found)


def _complete(boxes: Boxes2D) -> Columns:
    """The fields that tracks carry, present in any case."""
    num = len(boxes)
    unknown = np.full(num, np.nan)
    return {
        "camera": boxes.camera,
        "xyxy_px": boxes.xyxy_px,
        "label": np.full(num, "other") if boxes.label is None else boxes.label,
        "score": np.ones(num) if boxes.score is None else boxes.score,
        "distance_m": unknown if boxes.distance_m is None else boxes.distance_m,
        "range_rate_mps": unknown if boxes.range_rate_mps is None else boxes.range_rate_mps,
        "sources": np.zeros(num, np.uint8) if boxes.sources is None else boxes.sources,
    }


def _measure(boxes: Columns) -> Float64:
    """Centre x, y, area s and aspect ratio r (N, 4)."""
    from fbench.pipelines.tracking.kernels import as_measured  # numba takes a while to import

    return as_measured(np.array(boxes["xyxy_px"], np.float64, order="C"), MIN_SHAPE)


def _boxes(measured: Float64) -> Float64:
    """Left, top, right, bottom (N, 4) of centre, area and aspect ratio."""
    from fbench.pipelines.tracking.kernels import as_corners  # numba takes a while to import

    return as_corners(np.array(measured, np.float64, order="C"))


def _unit(measured: Float64) -> Float64:
    """What one box size means for each component (N, 4): a side, a side, the area, the aspect ratio."""
    unit = measured.copy()
    unit[:, 0] = unit[:, 1] = np.sqrt(measured[:, 2])
    return unit


def _with_valid_shape(moved: States, before: States) -> States:
    """Where a prediction would have no area or aspect, keep those of before and forget their rates."""
    bad = moved.place[:, 2:] < MIN_SHAPE
    if not bad.any():
        return moved
    values = moved.values.copy()
    values[kalman.PLACE, :, 2:][bad] = np.maximum(before.place[:, 2:][bad], MIN_SHAPE)
    values[kalman.RATE, :, 2:][bad] = 0.0
    return States(values)
