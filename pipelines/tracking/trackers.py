"""Trackers of boxes: in space, in world coordinates where poses are known, and in images, each camera for itself."""

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Generic, TypeVar

import numpy as np

from fbench.pipelines.tracking import association, kalman
from fbench.pipelines.tracking.kalman import PLACE, RATE, States
from fbench.pipelines.tracking.kernels import as_corners, as_measured, one_layout
from fbench.pipelines.tracking.params import MIN_STD, Tracker2DParams, Tracker3DParams, TrackerParams
from fbench.pipelines.tracking.tracks import Columns, Tracks, are_rivals, count_votes, rows, sort_detections
from fbench.replay.contracts.errors import DataError
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.geometry.iou import distance_bev, iou_2d
from fbench.replay.geometry.transforms import extrapolate, inverse, transform, wrap_angle

B = TypeVar("B", bound=Boxes2D | Boxes3D)
P = TypeVar("P", bound=TrackerParams)


class Tracker(ABC, Generic[B, P]):
    """Kalman filters with constant velocity, one a track; subclasses know what is measured and what fits.

    A step predicts all tracks, pairs them with detections and corrects those that got one. Tracks that were missed too
    often end. Every detection that is left, unless its score is weak, starts a track: see `_start_tracks`.

    Ids go by the order of detections in which tracks begin; with `any_order` detections are sorted by their content
    first, and those that aren't finite are left out.
    """

    kind: type[B]  # Of boxes
    place: str  # Name of the column that says where a detection is
    carries: tuple[str, ...]  # Names of all columns

    def __init__(self, params: P, *, any_order: bool = False) -> None:
        self._params, self._any_order, self._next_id = params, any_order, 1
        self.reset()

    def reset(self) -> None:
        """End all tracks; their ids are not used again."""
        self._tracks: Tracks | None = None
        self._stamp_ns = self._steps = 0
        self._with_label = False

    def step(self, boxes: B, stamp_ns: int, world_T_body: Float64 | None = None) -> B:
        """Take the detections at `stamp_ns`; returns the tracks, also those only predicted, in the same coordinates.

        Fields of the result are the same in every step; `label` is there where the detections have it. The pose counts
        in space alone. Raises DataError where `stamp_ns` isn't later than at the last step since the reset.
        """
        pose = self._take_pose(stamp_ns, world_T_body)
        detections = self._columns(boxes)
        if self._any_order:
            detections = sort_detections(detections, self.place)
        if pose is not None:
            detections = self._move(detections, pose)
        weak = np.asarray(detections["score"] < self._params.weak_score, np.bool_)
        if self._tracks is None:
            self._tracks = self._start_tracks(rows(detections, ~weak), stamp_ns)
        else:
            self._tracks = self._follow(self._advance(self._tracks, stamp_ns), detections, weak, stamp_ns)
        self._stamp_ns, self._steps = stamp_ns, self._steps + 1
        self._with_label = boxes.label is not None or (not len(boxes) and self._with_label)
        return self._report(self._tracks, pose)

    def predict(self, stamp_ns: int, world_T_body: Float64 | None = None) -> B:
        """Return tracks at an instant without detection, so that none missed anything. Raises DataError: see `step`."""
        pose = self._take_pose(stamp_ns, world_T_body)
        if self._tracks is None:
            return self._report(self._start_tracks(self._columns(self.kind.empty()), stamp_ns), pose)
        self._tracks = self._advance(self._tracks, stamp_ns)
        self._stamp_ns = stamp_ns
        return self._report(self._tracks, pose)

    def _start_tracks(self, detections: Columns, stamp_ns: int) -> Tracks:
        num, first_id = len(detections["score"]), self._next_id
        self._next_id += num
        return Tracks(
            track_id=first_id + np.arange(num),
            hits=np.ones(num, np.int64),
            missed=np.zeros(num, np.int64),
            updated_ns=np.full(num, stamp_ns, np.int64),
            votes=count_votes(detections["label"], detections["score"]),
            states=self._first_states(detections),
            last=detections,
        )

    def _follow(self, tracks: Tracks, detections: Columns, weak: Bool, stamp_ns: int) -> Tracks:
        at, columns, sure = self._pair(tracks, detections, weak, stamp_ns)
        found = rows(detections, columns)
        states = kalman.update(tracks.states.take(at, axis=1), *self._measure(found))
        carried = self._carry(tracks, at, found)
        if self._params.score == "mean":
            carried["score"] = mean_of(tracks.last["score"][at], found["score"], 1.0 / (tracks.hits[at] + 1))
        tracks = tracks.measure(at, carried, states, stamp_ns, sure)
        is_confirmed = (tracks.hits >= self._params.min_hits) & (tracks.missed <= self._params.max_missed)
        alive = tracks.select((tracks.missed == 0) | is_confirmed)
        new = ~weak
        new[columns[sure]] = False
        return alive.join(self._start_tracks(rows(detections, new), stamp_ns)) if new.any() else alive

    def _pair(self, tracks: Tracks, detections: Columns, weak: Bool, stamp_ns: int) -> tuple[Int64, Int64, Bool]:
        """Pair tracks with detections: rows of both, by track, and which pairs are sure.

        What fits is paired first, then what is left and within reach. Of a track that isn't confirmed yet, such a pair
        says how it may have moved, but not that it did: it is no hit, and its detection starts a track, too.
        """
        similarity, least = self._similarity(tracks, detections, stamp_ns)
        rivals = are_rivals(tracks.last["label"], detections["label"])
        similarity[rivals] = 0.0
        at, columns = association.associate_weak_last(similarity, least, weak)
        sure, is_complete = np.ones(len(at), np.bool_), len(at) == min(similarity.shape)
        near = None if is_complete else self._nearness(tracks, detections, stamp_ns)
        if near is None:
            return at, columns, sure
        near[rivals] = 0.0
        near[at] = near[:, columns] = near[:, weak] = 0.0
        more_at, more_columns = association.associate(near, 0.0)
        at, columns = np.concatenate([at, more_at]), np.concatenate([columns, more_columns])
        sure = np.concatenate([sure, tracks.hits[more_at] >= self._params.min_hits])
        order = np.argsort(at, kind="stable")
        return at[order], columns[order], sure[order]

    def _advance(self, tracks: Tracks, stamp_ns: int) -> Tracks:
        if stamp_ns <= self._stamp_ns:
            raise DataError(
                f"tracker: stamp {stamp_ns} isn't after {self._stamp_ns}, reset trackers where a segment begins"
            )
        return self._predict(tracks, (stamp_ns - self._stamp_ns) * 1e-9)

    def _report(self, tracks: Tracks, pose: Float64 | None) -> B:
        """Boxes of confirmed tracks that weren't missed too often or for too long; early on fewer hits are enough."""
        p = self._params
        coasted_s = (self._stamp_ns - tracks.updated_ns) * 1e-9
        is_confirmed = tracks.hits >= min(p.min_hits, self._steps)
        is_proven = tracks.hits >= tracks.missed * p.hits_per_missed
        is_recent = (tracks.missed <= p.max_missed_shown) & (coasted_s <= p.max_coast_s)
        tracks = tracks.select(is_confirmed & is_proven & is_recent)
        predicted = np.asarray(tracks.updated_ns < self._stamp_ns, np.bool_)
        found: Columns = tracks.last | {"track_id": tracks.track_id, "predicted": predicted, "label": tracks.labels()}
        if p.predicted_share < 1.0:  # negative scores, which are no probabilities, stay
            found["score"] = np.where(
                predicted & (found["score"] > 0), found["score"] * p.predicted_share, found["score"]
            )
        if not self._with_label:
            del found["label"]
        return self._boxes(found, tracks.states, pose)

    def _take_pose(self, stamp_ns: int, world_T_body: Float64 | None) -> Float64 | None:
        """Pose to track by; `None`: in the coordinates of the detections."""
        return None

    def _move(self, detections: Columns, dst_T_src: Float64) -> Columns:
        return detections

    def _columns(self, boxes: Boxes2D | Boxes3D) -> Columns:
        """The fields that tracks carry, present in any case."""
        num, columns = len(boxes), dict[str, Array]()
        unknown: Columns = {
            "label": np.full(num, "other"),
            "score": np.ones(num),
            "sources": np.zeros(num, np.uint8),
            "velocity_mps": np.full((num, 3), np.nan),
        }
        for name in self.carries:
            array = getattr(boxes, name)
            columns[name] = unknown.get(name, np.full(num, np.nan)) if array is None else array
        return columns

    @abstractmethod
    def _first_states(self, detections: Columns) -> States: ...

    @abstractmethod
    def _measure(self, detections: Columns) -> tuple[Float64, Float64]:
        """What the filters measure of detections (N, m), and its standard deviation."""

    @abstractmethod
    def _predict(self, tracks: Tracks, dt_s: float) -> Tracks: ...

    @abstractmethod
    def _similarity(self, tracks: Tracks, detections: Columns, stamp_ns: int) -> tuple[Float64, float]:
        """How well tracks and detections fit (T, M), whatever their labels, and how well a pair must."""

    def _nearness(self, tracks: Tracks, detections: Columns, stamp_ns: int) -> Float64 | None:
        """How near detections are to where tracks may have moved (T, M), 0 out of reach; `None`: it doesn't count."""
        return None

    @abstractmethod
    def _carry(self, tracks: Tracks, at: Int64, found: Columns) -> Columns:
        """What the tracks `at` carry on from the detections that measured them."""

    @abstractmethod
    def _boxes(self, found: Columns, states: States, pose: Float64 | None) -> B: ...


def mean_of(before: Float64, now: Float64, share: Float64) -> Float64:
    """Mean of what was (T, ...) and a new measurement with its share (T,)."""
    share = share.reshape(share.shape + (1,) * (now.ndim - 1))
    return before + share * (now - before)


class Tracker3D(Tracker[Boxes3D, Tracker3DParams]):
    """Linear Kalman filter with constant velocity per box, state (cx, cy, cz, vx, vy, vz) (thesis, Tracking).

    Size and heading are those measured last, or means. With poses the filter runs in world coordinates and velocities
    are over ground; without, it runs in body coordinates and velocities are relative to the body. Tracks start anew
    when the first pose comes; a pose missing later is extrapolated from the two before.
    """

    kind, place = Boxes3D, "center_m"
    carries = ("center_m", "size_lwh_m", "yaw_rad", "velocity_mps", "label", "score", "sources")

    def __init__(self, params: Tracker3DParams, *, any_order: bool = False) -> None:
        measured_std = params.measured_std_m if params.noise == "acceleration" else params.identity_r**0.5
        self._measured_std, self._rate_std, self._drift_std = (
            np.full(3, std) for std in (measured_std, params.rate_std_mps, params.drift_std_mps)
        )
        super().__init__(params, any_order=any_order)

    def reset(self) -> None:
        """End all tracks, whose ids are not used again, and forget all poses."""
        super().reset()
        self._poses: list[tuple[int, Float64]] = []  # The last two

    def _take_pose(self, stamp_ns: int, world_T_body: Float64 | None) -> Float64 | None:
        if not self._params.ego_motion:
            return None
        if world_T_body is not None:
            if not self._poses:
                self._tracks, self._steps = None, 0
            self._poses = [*self._poses[-1:], (stamp_ns, world_T_body)]
            return world_T_body
        if len(self._poses) < 2:
            return self._poses[0][1] if self._poses else None
        (before_ns, before), (last_ns, last) = self._poses  # goes on at constant speed and turn rate
        return extrapolate(before, last, (stamp_ns - last_ns) / (last_ns - before_ns))

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
        rates = np.nan_to_num(detections["velocity_mps"]) if self._poses else np.zeros_like(center)
        if self._params.noise == "identity":
            return kalman.begin_identity(center, rates, self._params.identity_p, self._params.identity_rate_p)
        return kalman.begin(center, rates, self._measured_std, self._rate_std)

    def _measure(self, detections: Columns) -> tuple[Float64, Float64]:
        return detections["center_m"], self._measured_std

    def _predict(self, tracks: Tracks, dt_s: float) -> Tracks:
        if self._params.noise == "identity":
            return replace(tracks, states=kalman.predict_identity(tracks.states, dt_s, self._params.identity_q))
        return replace(tracks, states=kalman.predict(tracks.states, dt_s, self._drift_std))

    def _similarity(self, tracks: Tracks, detections: Columns, stamp_ns: int) -> tuple[Float64, float]:
        p, center, found = self._params, tracks.states[PLACE], detections["center_m"]
        if p.association == "mahalanobis":
            near = association.mahalanobis_nearness(tracks.states, found, self._measured_std, p.max_mahalanobis)
            return near, 0.0
        if p.association == "distance":
            gate_m = p.gate_m + self._growth_mps(tracks) * self._wait_s(tracks, stamp_ns)
            return association.nearness(distance_bev(center, found), gate_m), 0.0
        a = np.column_stack([center, tracks.last["size_lwh_m"], tracks.last["yaw_rad"]])
        b = np.column_stack([found, detections["size_lwh_m"], detections["yaw_rad"]])
        if p.association == "giou":
            return association.as_similarity(association.giou_3d(a, b)), (p.min_giou + 1.0) / 2.0
        return association.footprint_iou(a, b), p.min_iou

    def _nearness(self, tracks: Tracks, detections: Columns, stamp_ns: int) -> Float64 | None:
        if self._params.association != "giou":
            return None
        slow_mps = np.where(tracks.labels() == "pedestrian", self._params.pedestrian_gate_mps, np.inf)
        reach_m = np.minimum(self._growth_mps(tracks), slow_mps) * self._wait_s(tracks, stamp_ns)
        far_m = distance_bev(tracks.states[PLACE], detections["center_m"])
        return association.nearness(far_m, np.maximum(reach_m, MIN_STD))

    def _growth_mps(self, tracks: Tracks) -> Float64:
        """By how much the reach of each track (T,) grows."""
        p = self._params
        has_velocity = np.isfinite(tracks.last["velocity_mps"]).all(axis=1) if self._poses else np.False_
        return np.where((tracks.hits == 1) & ~has_velocity, max(p.gate_mps, p.new_gate_mps), p.gate_mps)

    @staticmethod
    def _wait_s(tracks: Tracks, stamp_ns: int) -> Float64:
        """For how long each track (T,) wasn't measured."""
        return (stamp_ns - tracks.updated_ns).astype(np.float64) * 1e-9

    def _carry(self, tracks: Tracks, at: Int64, found: Columns) -> Columns:
        """Means where the parameters ask for them, else what was measured."""
        p, before, newest, result = self._params, tracks.last, 1.0 / (tracks.hits[at] + 1), dict(found)
        if p.size_share < 1.0:
            share = np.maximum(newest, p.size_share)
            result["size_lwh_m"] = mean_of(before["size_lwh_m"][at], found["size_lwh_m"], share)
        if p.yaw_share < 1.0:
            share = np.maximum(newest, p.yaw_share)
            result["yaw_rad"] = mean_yaw(before["yaw_rad"][at], found["yaw_rad"], share)[0]
        return result

    def _boxes(self, found: Columns, states: States, pose: Float64 | None) -> Boxes3D:
        found = found | {"center_m": states[PLACE], "velocity_mps": states[RATE]}
        return Boxes3D(**(found if pose is None else self._move(found, inverse(pose))))


def mean_yaw(before: Float64, now: Float64, share: Float64) -> tuple[Float64, Bool]:
    """Mean heading (T,) [rad], and which measurements (T,) pointed backward: they count turned by pi."""
    change = wrap_angle(now - before)
    backward = np.abs(change) > np.pi / 2
    change = np.where(backward, wrap_angle(change + np.pi), change)
    return wrap_angle(before + share * change), backward


MIN_SHAPE = 1e-3  # Least area [px^2] and aspect ratio that a prediction can shrink to


class Tracker2D(Tracker[Boxes2D, Tracker2DParams]):
    """Linear Kalman filter with constant velocity per box, state (x, y, s, r, vx, vy, vs, vr) (thesis, Tracking).

    s is the box's area and r its width by its height. Detections join tracks of the same camera by IoU. Distance and
    range rate of a track are those measured last; between measurements distance moves by range rate times time.
    """

    kind, place = Boxes2D, "xyxy_px"
    carries = ("camera", "xyxy_px", "label", "score", "distance_m", "range_rate_mps", "sources")

    def _first_states(self, detections: Columns) -> States:
        measured, measured_std = self._measure(detections)
        if self._params.noise == "identity":
            p = self._params
            return kalman.begin_identity(measured, np.zeros_like(measured), p.identity_p, p.identity_rate_p)
        return kalman.begin(measured, np.zeros_like(measured), measured_std, self._params.rate_std * _unit(measured))

    def _measure(self, detections: Columns) -> tuple[Float64, Float64]:
        measured = as_measured(one_layout(detections["xyxy_px"]), MIN_SHAPE)
        if self._params.noise == "identity":
            return measured, np.full(measured.shape, np.sqrt(self._params.identity_r))
        return measured, self._params.measured_std * _unit(measured)

    def _predict(self, tracks: Tracks, dt_s: float) -> Tracks:
        before = tracks.states
        if self._params.noise == "identity":
            states = kalman.predict_identity(before, dt_s, self._params.identity_q)
        else:
            states = kalman.predict(before, dt_s, self._params.drift_std * _unit(before[PLACE]))
        bad = states[PLACE, :, 2:] < MIN_SHAPE
        if bad.any():  # no area or aspect: keep that of before, and forget its rate
            states[PLACE, :, 2:][bad] = np.maximum(before[PLACE, :, 2:][bad], MIN_SHAPE)
            states[RATE, :, 2:][bad] = 0.0
        rate = tracks.last["range_rate_mps"]
        distance = tracks.last["distance_m"] + np.where(np.isnan(rate), 0.0, rate) * dt_s
        return replace(tracks, states=states, last=tracks.last | {"distance_m": distance})

    def _similarity(self, tracks: Tracks, detections: Columns, stamp_ns: int) -> tuple[Float64, float]:
        p, least = self._params, 0.0
        boxes, found = as_corners(one_layout(tracks.states[PLACE])), detections["xyxy_px"]
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
        kept = {n: np.where(np.isnan(found[n]), tracks.last[n][at], found[n]) for n in ("distance_m", "range_rate_mps")}
        return found | kept

    def _boxes(self, found: Columns, states: States, pose: Float64 | None) -> Boxes2D:
        return Boxes2D(**(found | {"xyxy_px": as_corners(one_layout(states[PLACE]))}))


def _unit(measured: Float64) -> Float64:
    """What one box size means for each component (N, 4): a side, a side, the area, the aspect ratio."""
    unit = measured.copy()
    unit[:, 0] = unit[:, 1] = np.sqrt(measured[:, 2])
    return unit
