"""Tracks boxes in 3D, in world coordinates where the body's pose is known."""

from dataclasses import replace

import numpy as np

from fbench.pipelines.tracking import association as like
from fbench.pipelines.tracking import kalman
from fbench.pipelines.tracking import tracks as smoothing
from fbench.pipelines.tracking.association import associate_weak_last, canonical, nearness
from fbench.pipelines.tracking.params import Tracker3DParams
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
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.geometry.iou import distance_bev
from fbench.replay.geometry.transforms import extrapolated, inverse, transform, wrap_angle


class EgoPoses:
    """Remembers the last two poses, and goes on from them at constant speed and turn rate."""

    def __init__(self) -> None:
        self._poses: list[tuple[int, Float64]] = []

    @property
    def known(self) -> bool:
        """Whether there was a pose."""
        return bool(self._poses)

    def step(self, stamp_ns: int, world_T_body: Float64 | None) -> Float64 | None:
        """Return the pose (4, 4) to use at `stamp_ns`; `None` before the first."""
        if world_T_body is not None:
            self._poses = [*self._poses[-1:], (stamp_ns, world_T_body)]
            return world_T_body
        if len(self._poses) < 2:
            return self._poses[0][1] if self._poses else None
        (before_ns, before), (last_ns, last) = self._poses
        return extrapolated(before, last, (stamp_ns - last_ns) / (last_ns - before_ns))


__all__ = ["Tracker3D", "Tracker3DParams", "moved"]


class Tracker3D:
    """Linear Kalman filter with constant velocity per box, state (cx, cy, cz, vx, vy, vz) (thesis, Tracking).

    Size and heading are those measured last, or means. With poses the filter runs in world coordinates and velocities
    are over ground; without, it runs in body coordinates and velocities are relative to the body. Tracks start anew
    when the first pose comes; a pose missing later is extrapolated from the two before.

    Ids go by the order of detections in which tracks begin; with `any_order` detections are sorted by their content
    first, and those that aren't finite are left out.
    """

    def __init__(self, params: Tracker3DParams, *, any_order: bool = False) -> None:
        self._params = params
        self._any_order = any_order
        self._measured_std, self._rate_std, self._drift_std = (
            np.full(3, std) for std in (params.measured_std_m, params.rate_std_mps, params.drift_std_mps)
        )
        self._next_id = 1
        self.reset()

    def reset(self) -> None:
        """End all tracks; their ids are not used again."""
        self._tracks: Tracks | None = None
        self._ego = EgoPoses()
        self._stamp_ns = 0
        self._steps = 0
        self._with_label = False

    def step(self, boxes: Boxes3D, stamp_ns: int, world_T_body: Float64 | None) -> Boxes3D:
        """Take detections in body coordinates; returns the tracks, also those only predicted, likewise.

        Fields of the result are the same in every step; `label` is there where the detections have it.

        Raises:
            DataError: where `stamp_ns` isn't later than at the last step since the reset.
        """
        pose = self._pose(stamp_ns, world_T_body)
        detections = _complete(boxes)
        if self._any_order:
            detections = canonical(detections, "center_m")
        detections = detections if pose is None else moved(detections, pose)
        if self._tracks is None:
            tracks = self._begin(rows(detections, ~self._weak(detections)), stamp_ns)
        else:
            tracks = self._follow(self._predicted(self._tracks, stamp_ns), detections, stamp_ns)
        self._tracks, self._stamp_ns, self._steps = tracks, stamp_ns, self._steps + 1
        self._with_label = boxes.label is not None or (not len(boxes) and self._with_label)
        return self._shown(tracks, pose)

    def predict(self, stamp_ns: int, world_T_body: Float64 | None) -> Boxes3D:
        """Return where the tracks are at an instant at which nothing was looked for, so that none missed anything.

        Raises:
            DataError: see `step`.
        """
        pose = self._pose(stamp_ns, world_T_body)
        if self._tracks is None:
            return self._shown(self._begin(_complete(Boxes3D.empty()), stamp_ns), pose)
        self._tracks = self._predicted(self._tracks, stamp_ns)
        self._stamp_ns = stamp_ns
        return self._shown(self._tracks, pose)

    def _pose(self, stamp_ns: int, world_T_body: Float64 | None) -> Float64 | None:
        if not self._params.ego_motion:
            return None
        if world_T_body is not None and not self._ego.known:
            self._tracks, self._steps = None, 0
        return self._ego.step(stamp_ns, world_T_body)

    def _weak(self, detections: Columns) -> Bool:
        return np.asarray(detections["score"] < self._params.weak_score, np.bool_)

    def _begin(self, detections: Columns, stamp_ns: int) -> Tracks:
        center = detections["center_m"]
        rates = np.nan_to_num(detections["velocity_mps"]) if self._ego.known else np.zeros_like(center)
        states = kalman.begin(center, rates, self._measured_std, self._rate_std)
        first_id, self._next_id = self._next_id, self._next_id + len(center)
        return first_tracks(detections, states, first_id, stamp_ns)

    def _predicted(self, tracks: Tracks, stamp_ns: int) -> Tracks:
        dt_s = seconds_since(self._stamp_ns, stamp_ns)
        return replace(tracks, states=kalman.predict(tracks.states, dt_s, self._drift_std))

    def _follow(self, tracks: Tracks, detections: Columns, stamp_ns: int) -> Tracks:
        p = self._params
        weak = self._weak(detections)
        similarity, least = self._similarity(tracks, detections, stamp_ns)
        at, columns = associate_weak_last(similarity, least, weak)
        measured = rows(detections, columns)
        states = kalman.update(tracks.states.rows(at), measured["center_m"], self._measured_std)
        carried = self._smoothed(tracks, at, measured)
        tracks = measured_tracks(tracks, at, carried, states, stamp_ns)
        new = ~weak
        new[columns] = False
        alive = selected(tracks, surviving(tracks, p.min_hits, p.max_missed))
        return join_tracks(alive, self._begin(rows(detections, new), stamp_ns)) if new.any() else alive

    def _similarity(self, tracks: Tracks, detections: Columns, stamp_ns: int) -> tuple[Float64, float]:
        """How well tracks and detections fit (T, M), and how well a pair must."""
        similarity, least = self._likeness(tracks, detections, stamp_ns)
        similarity[rivals(tracks.last["label"], detections["label"])] = 0.0
        return similarity, least

    def _likeness(self, tracks: Tracks, detections: Columns, stamp_ns: int) -> tuple[Float64, float]:
        p, centre, found = self._params, tracks.states.place, detections["center_m"]
        if p.association == "distance":
            return nearness(distance_bev(centre, found), self._gate_m(tracks, stamp_ns)), 0.0
        if p.association == "mahalanobis":
            return like.mahalanobis_nearness(tracks.states, found, self._measured_std, p.max_mahalanobis), 0.0
        a, b = _upright(centre, tracks.last), _upright(found, detections)
        if p.association == "giou":
            return like.as_similarity(like.giou_3d(a, b)), (p.min_giou + 1.0) / 2.0
        return like.footprint_iou(a, b), p.min_iou

    def _gate_m(self, tracks: Tracks, stamp_ns: int) -> Float64:
        """Greatest distance of a detection from each track (T,) [m]."""
        p = self._params
        is_told = np.isfinite(tracks.last["velocity_mps"]).all(axis=1) if self._ego.known else np.False_
        grow_mps = np.where((tracks.hits == 1) & ~is_told, max(p.gate_mps, p.new_gate_mps), p.gate_mps)
        unmeasured_s = (stamp_ns - tracks.updated_ns).astype(np.float64) * 1e-9
        return np.asarray(p.gate_m + grow_mps * unmeasured_s, np.float64)

    def _smoothed(self, tracks: Tracks, at: Int64, measured: Columns) -> Columns:
        """What the tracks `at` carry on: means where the parameters ask for them, else what was measured."""
        p, hits, before, result = self._params, tracks.hits[at] + 1, tracks.last, dict(measured)
        if p.size_share < 1.0:
            share = smoothing.weight(hits, p.size_share)
            result["size_lwh_m"] = smoothing.mean_of(before["size_lwh_m"][at], measured["size_lwh_m"], share)
        if p.yaw_share < 1.0:
            share = smoothing.weight(hits, p.yaw_share)
            result["yaw_rad"] = smoothing.mean_yaw(before["yaw_rad"][at], measured["yaw_rad"], share)[0]
        if p.score == "mean":
            share = smoothing.weight(hits, 0.0)
            result["score"] = smoothing.mean_of(before["score"][at], measured["score"], share)
        return result

    def _shown(self, tracks: Tracks, pose: Float64 | None) -> Boxes3D:
        p = self._params
        tracks = selected(tracks, shown(tracks, self._stamp_ns, self._steps, p))
        predicted = np.asarray(tracks.updated_ns < self._stamp_ns, np.bool_)
        found: Columns = tracks.last | {
            "center_m": tracks.states.place,
            "velocity_mps": tracks.states.rate,
            "score": smoothing.coasted_score(tracks.last["score"], predicted, p.predicted_share),
            "track_id": tracks.track_id,
            "predicted": predicted,
        }
        found["label"] = tracks.labels()
        if not self._with_label:
            del found["label"]
        return Boxes3D(**(found if pose is None else moved(found, inverse(pose))))


def moved(boxes: Columns, dst_T_src: Float64) -> Columns:
    """Move boxes to another coordinate frame; their headings turn about z alone."""
    yaw = np.arctan2(dst_T_src[1, 0], dst_T_src[0, 0])
    turn = dst_T_src.copy()
    turn[:3, 3] = 0.0
    return boxes | {
        "center_m": transform(dst_T_src, boxes["center_m"]),
        "yaw_rad": wrap_angle(boxes["yaw_rad"] + yaw),
        "velocity_mps": transform(turn, boxes["velocity_mps"]),
    }


def _complete(boxes: Boxes3D) -> Columns:
    """The fields that tracks carry, present in any case."""
    num = len(boxes)
    return {
        "center_m": boxes.center_m,
        "size_lwh_m": boxes.size_lwh_m,
        "yaw_rad": boxes.yaw_rad,
        "velocity_mps": np.full((num, 3), np.nan) if boxes.velocity_mps is None else boxes.velocity_mps,
        "label": np.full(num, "other") if boxes.label is None else boxes.label,
        "score": np.ones(num) if boxes.score is None else boxes.score,
        "sources": np.zeros(num, np.uint8) if boxes.sources is None else boxes.sources,
    }


def _upright(center_m: Float64, boxes: Columns) -> Float64:
    """Centre, size and heading (N, 7)."""
    return np.column_stack([center_m, boxes["size_lwh_m"], boxes["yaw_rad"]])
