"""Tracking of boxes in images, each camera for itself."""

from dataclasses import replace

import numpy as np

from fbench.pipelines.tracking import association, kalman
from fbench.pipelines.tracking.kalman import States
from fbench.pipelines.tracking.params import Tracker2DParams
from fbench.pipelines.tracking.tracks import Columns, Tracker, Tracks, mean_of, newest_share
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.boxes import Boxes2D

__all__ = ["Tracker2D", "Tracker2DParams"]

MIN_SHAPE = 1e-3  # Least area [px^2] and aspect ratio that a prediction can shrink to


class Tracker2D(Tracker[Boxes2D]):
    """Linear Kalman filter with constant velocity per box, state (x, y, s, r, vx, vy, vs, vr) (thesis, Tracking).

    s is the box's area and r its width by its height. Detections join tracks of the same camera by IoU. Distance and
    range rate of a track are those measured last; between measurements distance moves by range rate times time.
    """

    kind, place = Boxes2D, "xyxy_px"
    carries = ("camera", "xyxy_px", "label", "score", "distance_m", "range_rate_mps", "sources")

    def __init__(self, params: Tracker2DParams, *, any_order: bool = False) -> None:
        self._params = params
        super().__init__(params, any_order)

    def _first_states(self, detections: Columns) -> States:
        measured, measured_std = self._measure(detections)
        return kalman.begin(measured, np.zeros_like(measured), measured_std, self._params.rate_std * _unit(measured))

    def _measure(self, detections: Columns) -> tuple[Float64, Float64]:
        from fbench.pipelines.tracking.kernels import as_measured  # numba takes a while to import

        measured = as_measured(np.array(detections["xyxy_px"], np.float64, order="C"), MIN_SHAPE)
        return measured, self._params.measured_std * _unit(measured)

    def _predict(self, tracks: Tracks, dt_s: float) -> Tracks:
        before = tracks.states
        states = kalman.predict(before, dt_s, self._params.drift_std * _unit(before.place))
        bad = states.place[:, 2:] < MIN_SHAPE
        if bad.any():  # no area or aspect: keep that of before, and forget its rate
            values = states.values.copy()
            values[kalman.PLACE, :, 2:][bad] = np.maximum(before.place[:, 2:][bad], MIN_SHAPE)
            values[kalman.RATE, :, 2:][bad] = 0.0
            states = States(values)
        rate = tracks.last["range_rate_mps"]
        distance = tracks.last["distance_m"] + np.where(np.isnan(rate), 0.0, rate) * dt_s
        return replace(tracks, states=states, last=tracks.last | {"distance_m": distance})

    def _similarity(self, tracks: Tracks, detections: Columns, stamp_ns: int) -> tuple[Float64, float]:
        p, least = self._params, 0.0
        boxes, found = _corners(tracks.states.place), detections["xyxy_px"]
        if p.association == "mahalanobis":
            measured, std = self._measure(detections)
            similarity = association.mahalanobis_nearness(tracks.states, measured, std, p.max_mahalanobis)
        elif p.association == "giou":
            similarity, least = association.as_similarity(association.giou_2d(boxes, found)), (p.min_giou + 1.0) / 2.0
        else:
            similarity, least = association.image_iou(boxes, found), p.min_iou
        one, other = tracks.last["camera"], detections["camera"]
        if len({*one.tolist(), *other.tolist()}) > 1:
            similarity[one[:, None] != other[None, :]] = 0.0
        return similarity, least

    def _carry(self, tracks: Tracks, at: Int64, found: Columns) -> Columns:
        kept: Columns = {}
        for name in ("distance_m", "range_rate_mps"):
            kept[name] = np.where(np.isnan(found[name]), tracks.last[name][at], found[name])
        if self._params.score == "mean":
            share = newest_share(tracks.hits[at] + 1, 0.0)
            kept["score"] = mean_of(tracks.last["score"][at], found["score"], share)
        return found | kept

    def _boxes(self, found: Columns, states: States, pose: Float64 | None) -> Boxes2D:
        return Boxes2D(**(found | {"xyxy_px": _corners(states.place)}))


def _corners(measured: Float64) -> Float64:
    """Left, top, right, bottom (N, 4) of center, area and aspect ratio."""
    from fbench.pipelines.tracking.kernels import as_corners  # numba takes a while to import

    return as_corners(np.array(measured, np.float64, order="C"))


def _unit(measured: Float64) -> Float64:
    """What one box size means for each component (N, 4): a side, a side, the area, the aspect ratio."""
    unit = measured.copy()
    unit[:, 0] = unit[:, 1] = np.sqrt(measured[:, 2])
    return unit
