"""Tracking of boxes: in space, in world coordinates where poses are known, and in images, each camera for itself."""

from dataclasses import replace

import numpy as np

from fbench.pipelines.tracking import association, kalman
from fbench.pipelines.tracking.kalman import States
from fbench.pipelines.tracking.params import Tracker2DParams, Tracker3DParams
from fbench.pipelines.tracking.tracks import Columns, Tracker, Tracks, mean_of, newest_share
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.geometry.iou import distance_bev, iou_2d
from fbench.replay.geometry.transforms import extrapolate, inverse, transform, wrap_angle


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
        return extrapolate(before, last, (stamp_ns - last_ns) / (last_ns - before_ns))


class Tracker3D(Tracker[Boxes3D]):
    """Linear Kalman filter with constant velocity per box, state (cx, cy, cz, vx, vy, vz) (thesis, Tracking).

    Size and heading are those measured last, or means. With poses the filter runs in world coordinates and velocities
    are over ground; without, it runs in body coordinates and velocities are relative to the body. Tracks start anew
    when the first pose comes; a pose missing later is extrapolated from the two before.
    """

    kind, place = Boxes3D, "center_m"
    carries = ("center_m", "size_lwh_m", "yaw_rad", "velocity_mps", "label", "score", "sources")

    def __init__(self, params: Tracker3DParams, *, any_order: bool = False) -> None:
        self._params = params
        self._measured_std, self._rate_std, self._drift_std = (
            np.full(3, std) for std in (params.measured_std_m, params.rate_std_mps, params.drift_std_mps)
        )
        super().__init__(params, any_order)

    def reset(self) -> None:
        """End all tracks, whose ids are not used again, and forget all poses."""
        super().reset()
        self._ego = EgoPoses()

    def _take_pose(self, stamp_ns: int, world_T_body: Float64 | None) -> Float64 | None:
        if not self._params.ego_motion:
            return None
        if world_T_body is not None and not self._ego.known:
            self._tracks, self._steps = None, 0
        return self._ego.step(stamp_ns, world_T_body)

    def _move(self, detections: Columns, dst_T_src: Float64) -> Columns:
        """Move boxes to another coordinate frame; their headings turn about z alone."""
        yaw = np.arctan2(dst_T_src[1, 0], dst_T_src[0, 0])
        turn = dst_T_src.copy()
        turn[:3, 3] = 0.0
        return detections | {
            "center_m": transform(dst_T_src, detections["center_m"]),
            "yaw_rad": wrap_angle(detections["yaw_rad"] + yaw),
            "velocity_mps": transform(turn, detections["velocity_mps"]),
        }

    def _first_states(self, detections: Columns) -> States:
        center = detections["center_m"]
        rates = np.nan_to_num(detections["velocity_mps"]) if self._ego.known else np.zeros_like(center)
        return kalman.begin(center, rates, self._measured_std, self._rate_std)

    def _measure(self, detections: Columns) -> tuple[Float64, Float64]:
        return detections["center_m"], self._measured_std

    def _predict(self, tracks: Tracks, dt_s: float) -> Tracks:
        return replace(tracks, states=kalman.predict(tracks.states, dt_s, self._drift_std))

    def _similarity(self, tracks: Tracks, detections: Columns, stamp_ns: int) -> tuple[Float64, float]:
        p, center, found = self._params, tracks.states.place, detections["center_m"]
        if p.association == "distance":
            has_velocity = np.isfinite(tracks.last["velocity_mps"]).all(axis=1) if self._ego.known else np.False_
            grow_mps = np.where((tracks.hits == 1) & ~has_velocity, max(p.gate_mps, p.new_gate_mps), p.gate_mps)
            gate_m = p.gate_m + grow_mps * ((stamp_ns - tracks.updated_ns).astype(np.float64) * 1e-9)
            return association.nearness(distance_bev(center, found), gate_m), 0.0
        if p.association == "mahalanobis":
            near = association.mahalanobis_nearness(tracks.states, found, self._measured_std, p.max_mahalanobis)
            return near, 0.0
        a = np.column_stack([center, tracks.last["size_lwh_m"], tracks.last["yaw_rad"]])
        b = np.column_stack([found, detections["size_lwh_m"], detections["yaw_rad"]])
        if p.association == "giou":
            return association.as_similarity(association.giou_3d(a, b)), (p.min_giou + 1.0) / 2.0
        return association.footprint_iou(a, b), p.min_iou

    def _carry(self, tracks: Tracks, at: Int64, found: Columns) -> Columns:
        """Means where the parameters ask for them, else what was measured."""
        p, hits, before, result = self._params, tracks.hits[at] + 1, tracks.last, dict(found)
        if p.size_share < 1.0:
            share = newest_share(hits, p.size_share)
            result["size_lwh_m"] = mean_of(before["size_lwh_m"][at], found["size_lwh_m"], share)
        if p.yaw_share < 1.0:
            share = newest_share(hits, p.yaw_share)
            result["yaw_rad"] = mean_yaw(before["yaw_rad"][at], found["yaw_rad"], share)[0]
        if p.score == "mean":
            result["score"] = mean_of(before["score"][at], found["score"], newest_share(hits, 0.0))
        return result

    def _boxes(self, found: Columns, states: States, pose: Float64 | None) -> Boxes3D:
        found = found | {"center_m": states.place, "velocity_mps": states.rate}
        return Boxes3D(**(found if pose is None else self._move(found, inverse(pose))))


def mean_yaw(before: Float64, now: Float64, share: Float64) -> tuple[Float64, Bool]:
    """Mean heading (T,) [rad], and which measurements (T,) pointed backward: they count turned by pi."""
    change = wrap_angle(now - before)
    backward = np.abs(change) > np.pi / 2
    change = np.where(backward, wrap_angle(change + np.pi), change)
    return wrap_angle(before + share * change), backward


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
            similarity, least = iou_2d(boxes, found), p.min_iou
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
