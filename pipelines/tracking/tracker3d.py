"""Tracks boxes in 3D, in world coordinates where the body's pose is known."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fbench.pipelines.checks import require_between
from fbench.pipelines.tracking import kalman
from fbench.pipelines.tracking.association import associate, nearness
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
from fbench.replay.boxes import Boxes3D
from fbench.replay.geometry.boxes import distance_bev
from fbench.replay.geometry.rotated import iou_bev
from fbench.replay.geometry.transforms import extrapolated, inverse, transform, wrap_angle


@dataclass(frozen=True)
class Tracker3DParams:
    """Parameters of the 3D tracker."""

    association: Literal["distance", "iou"] = "distance"
    """`distance`: nearest centres on the ground within a gate; `iou`: overlap seen from above."""
    gate_m: float = 3.0
    """Greatest distance of a detection from a track's prediction [m], plus `gate_mps` times the time without one."""
    gate_mps: float = 8.0
    """By how much the gate grows [m] for each second since a track was measured."""
    min_iou: float = 0.05
    """With `iou`: detections that overlap a track's prediction less than this don't belong to it."""
    max_missed: int = 2
    """A track ends when more steps than this in a row didn't measure it, or one before it had `min_hits`."""
    max_coast_s: float = 0.5
    """A track that nothing measured for longer than this [s] is not shown, since its prediction is too uncertain."""
    min_hits: int = 2
    """Measurements before a track is shown; in the first steps after a reset fewer are enough."""
    measured_std_m: float = 0.3
    """Standard deviation of a measured centre [m]."""
    rate_std_mps: float = 10.0
    """Standard deviation of a new track's velocity [m/s]."""
    drift_std_mps: float = 5.0
    """Change of velocity within one second, standard deviation [m/s]."""

    def __post_init__(self) -> None:
        require_between("tracking.min_iou", self.min_iou, 0.0, 1.0)
        for name in ("gate_mps", "max_missed", "max_coast_s", "min_hits", "rate_std_mps", "drift_std_mps"):
            require_between(f"tracking.{name}", getattr(self, name), 0)
        for name in ("gate_m", "measured_std_m"):
            require_between(f"tracking.{name}", getattr(self, name), 1e-6)


class Tracker3D:
    """Linear Kalman filter with constant velocity per box, state (cx, cy, cz, vx, vy, vz) (thesis, Tracking).

    Size and heading are those measured last. With poses the filter runs in world coordinates and velocities are
    over ground; without, it runs in body coordinates and velocities are relative to the body. Tracks start anew when
    the first pose comes; a pose missing later is extrapolated from the two before.
    """

    def __init__(self, params: Tracker3DParams) -> None:
        self._params = params
        self._next_id = 1
        self.reset()

    def reset(self) -> None:
        """End all tracks; their ids are not used again."""
        self._tracks: Tracks[Boxes3D] | None = None
        self._poses: list[tuple[int, Float64]] = []
        self._stamp_ns = 0
        self._steps = 0

    def step(self, boxes: Boxes3D, stamp_ns: int, world_T_body: Float64 | None) -> Boxes3D:
        """Take detections in body coordinates; returns the tracks, also those only predicted, likewise.

        Fields of the result are the same in every step; `label` is there where the detections have it.

        Raises:
            DataError: where `stamp_ns` isn't later than at the last step since the reset.
        """
        pose = self._pose(stamp_ns, world_T_body)
        detections = _complete(boxes if pose is None else moved(boxes, pose))
        if self._tracks is None:
            tracks = self._begin(detections, stamp_ns)
        else:
            tracks = self._follow(self._tracks, detections, stamp_ns)
        self._tracks, self._stamp_ns, self._steps = tracks, stamp_ns, self._steps + 1
        shown = self._shown(tracks, with_label=boxes.label is not None)
        return shown if pose is None else moved(shown, inverse(pose))

    def _pose(self, stamp_ns: int, world_T_body: Float64 | None) -> Float64 | None:
        if world_T_body is not None:
            if not self._poses:
                self._tracks, self._steps = None, 0
            self._poses = [*self._poses[-1:], (stamp_ns, world_T_body)]
            return world_T_body
        if len(self._poses) < 2:
            return self._poses[0][1] if self._poses else None
        (before_ns, before), (last_ns, last) = self._poses
        return extrapolated(before, last, (stamp_ns - last_ns) / (last_ns - before_ns))

    def _begin(self, detections: Boxes3D, stamp_ns: int) -> Tracks[Boxes3D]:
        p = self._params
        rates = np.zeros((len(detections), 3))
        if self._poses and detections.velocity_mps is not None:
            rates = np.nan_to_num(detections.velocity_mps)
        states = kalman.begin(detections.center_m, rates, np.full(3, p.measured_std_m), np.full(3, p.rate_std_mps))
        first_id, self._next_id = self._next_id, self._next_id + len(detections)
        return first_tracks(detections, states, first_id, stamp_ns)

    def _follow(self, tracks: Tracks[Boxes3D], detections: Boxes3D, stamp_ns: int) -> Tracks[Boxes3D]:
        p = self._params
        dt_s = seconds_since(self._stamp_ns, stamp_ns)
        tracks = replace(tracks, states=kalman.predict(tracks.states, dt_s, np.full(3, p.drift_std_mps)))
        rows, columns = self._associate(tracks, detections, stamp_ns)
        states = kalman.update(tracks.states.rows(rows), detections.center_m[columns], np.full(3, p.measured_std_m))
        tracks = measured_tracks(tracks, rows, detections[columns], states, stamp_ns)
        new = np.ones(len(detections), bool)
        new[columns] = False
        alive = tracks.rows(surviving(tracks, p.min_hits, p.max_missed))
        return joined(alive, self._begin(detections[new], stamp_ns))

    def _associate(self, tracks: Tracks[Boxes3D], detections: Boxes3D, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        p = self._params
        predicted = replace(tracks.last, center_m=tracks.states.mean[:, :3])
        if p.association == "iou":
            similarity, least = iou_bev(predicted, detections), p.min_iou
        else:
            unmeasured_s = (stamp_ns - tracks.updated_ns).astype(np.float64) * 1e-9
            gate = p.gate_m + p.gate_mps * unmeasured_s
            similarity, least = nearness(distance_bev(predicted.center_m, detections.center_m), gate), 0.0
        apart = rivals(tracks.last.label, detections.label, similarity.shape)
        return associate(np.where(apart, 0.0, similarity), least)

    def _shown(self, tracks: Tracks[Boxes3D], *, with_label: bool) -> Boxes3D:
        p = self._params
        coasted_s = (self._stamp_ns - tracks.updated_ns) * 1e-9
        tracks = tracks.rows((tracks.hits >= min(p.min_hits, self._steps)) & (coasted_s <= p.max_coast_s))
        return replace(
            tracks.last,
            center_m=tracks.states.mean[:, :3],
            velocity_mps=tracks.states.mean[:, 3:],
            label=tracks.labels() if with_label else None,
            track_id=tracks.track_id,
            predicted=tracks.missed > 0,
        )


def moved(boxes: Boxes3D, dst_T_src: Float64) -> Boxes3D:
    """Move boxes to another coordinate frame; their headings turn about z alone."""
    yaw = np.arctan2(dst_T_src[1, 0], dst_T_src[0, 0])
    turn = dst_T_src.copy()
    turn[:3, 3] = 0.0
    velocity = None if boxes.velocity_mps is None else transform(turn, boxes.velocity_mps)
    return replace(
        boxes,
        center_m=transform(dst_T_src, boxes.center_m),
        yaw_rad=wrap_angle(boxes.yaw_rad + yaw),
        velocity_mps=velocity,
    )


def _complete(boxes: Boxes3D) -> Boxes3D:
    """The fields that tracks carry, present in any case."""
    num = len(boxes)
    return Boxes3D(
        center_m=boxes.center_m,
        size_lwh_m=boxes.size_lwh_m,
        yaw_rad=boxes.yaw_rad,
        velocity_mps=np.full((num, 3), np.nan) if boxes.velocity_mps is None else boxes.velocity_mps,
        label=np.full(num, "other") if boxes.label is None else boxes.label,
        score=np.ones(num) if boxes.score is None else boxes.score,
        sources=np.zeros(num, np.uint8) if boxes.sources is None else boxes.sources,
    )
