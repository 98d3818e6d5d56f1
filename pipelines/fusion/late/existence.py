"""Existence of objects: by the sensors that see them and those that should and don't."""

from dataclasses import dataclass, field, replace

import numpy as np

from fbench.pipelines.fusion.joint import expected_share
from fbench.pipelines.fusion.kernels import nearest_by_bearing, occlusion_shares
from fbench.pipelines.fusion.late.association import Association
from fbench.pipelines.fusion.late.place import Observations
from fbench.pipelines.fusion.observations import AssociationParams, CameraObservation, Clusters, outline_overlaps
from fbench.pipelines.fusion.reliability import AgreementParams, SensorReliability, saturate, sureness
from fbench.pipelines.sensors.bev.grid import in_reach
from fbench.pipelines.sensors.odds import log_odds, probability_of
from fbench.replay.contracts.params import CheckedParams, in_range
from fbench.replay.data.arrays import Bool, Float64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.geometry.camera import in_image, project_body

_BINS = 720
_SECTORS = 36
_HIDES_M = (0.5, 2.2)
_BEHIND_M = 1.5
_HALF_M, _HALF_WITH_ECHOES_M = 25.0, 50.0  # See `FusionParams.lidar_half_m`


@dataclass(frozen=True)
class FusionParams(CheckedParams, prefix="fusion"):
    """How objects that several sensors see become one, and how sure that makes us.

    The log-odds that an object exists are those of `prior`; each sensor that sees it adds how much surer it is than
    that, and each that doesn't see it log(1 - the probability that it would).
    """

    association: AssociationParams = field(default_factory=AssociationParams)  # What belongs together.
    agreement: AgreementParams = field(default_factory=AgreementParams)  # How well the sensors work.
    camera_share: float = in_range(0.5, 0, 1)
    """Boxes down to this share of a camera's `min_score` [0 to 1] count where LiDAR or moving echoes confirm them.
    Echoes that a network got and took for nothing confirm nothing, here and below."""
    prior: float = in_range(0.13, 0, 1)
    """Probability of an object where nothing is known [0 to 1]; the lower, the more it says that several sensors see
    one."""
    overlap: float = in_range(3.0, 0, 100)
    """Times how far the IoU of an object that LiDAR places, projected, with the camera's box is above 0.5: what it adds
    to the log-odds."""
    lidar_weight: float | None = in_range(None, 0, 1)
    """How far a LiDAR cluster's score is believed [0 to 1]; none: 1 where the model alone judges (`lidar.judge`), else
    0.5, or 0.65 without cameras: what rules take for a car is often something else, which cameras mostly see."""
    radar_weight: float = in_range(0.8, 0, 1)  # How far the score of moving echoes is believed [0 to 1].
    standing_weight: float = in_range(0.19, 0, 1)
    """How far stationary echoes at the place of what only cameras see, and clusters of echoes without velocity, are
    believed [0 to 1]."""
    confirmed_lidar: float = in_range(0.19, 0, 1)
    """Probability that many LiDAR points where a camera sees an object belong to one, whatever their shape [0 to
    1]."""
    confirmed_radar: float = in_range(0.66, 0, 1)  # The same of moving echoes [0 to 1].
    unlikely: float = in_range(0.2, 1e-6, 1)
    """What a radar or camera reports where something hides it from view is believed as if it saw this share of such
    objects [0 to 1]: most of it are mirrored images, or aren't there."""
    full_points: float = in_range(8.0, 0.1, 1e6)  # Of n points 1 - exp(-n / this) of that is believed.
    camera_height_px: float = in_range(12.0, 0.1, 10_000)  # Height [px] at which a camera sees every second object.
    lidar_half_m: float | None = in_range(None, 1, 1e6)
    """Distance [m] at which every second object has enough LiDAR points to be found; none: 25 m, or 50 m where a
    network gets echoes, too."""
    max_range_m: float = in_range(60.0, 1, 1000)  # LiDAR and radar aren't expected to see farther objects [m].
    max_detection: float = in_range(0.95, 0, 1)  # No sensor sees more than this share of what it could [0 to 1].
    min_score: float = in_range(0.4, 0, 1)  # Objects with a lower probability are dropped.


@dataclass(frozen=True, eq=False)
class Witness:
    """Statement of one sensor about N objects."""

    name: str
    kind: str
    seen: Bool  # (N,) whether it sees them
    odds: Float64  # (N,) what it adds to their log-odds where it does, if nothing else is known
    confirmed_odds: Float64  # (N,) the same where a camera sees them, too
    could: Float64  # (N,) probability that a sensor that works sees them


@dataclass(frozen=True, eq=False)
class Evidence:
    """All that fusion knows of the objects (N) of one frame."""

    observations: Observations
    associations: list[Association]
    targets: Boxes3D  # (N) what may be there, in body coordinates
    standing: Float64  # (N,) number of stationary echoes at the place of each object

    @property
    def distance_m(self) -> Float64:
        """(N,) of each object's middle from the body's origin [m]."""
        return np.asarray(np.hypot(self.targets.center_m[:, 0], self.targets.center_m[:, 1]), np.float64)

    @property
    def ignored(self) -> Bool:
        """(N,) those whose echoes, if there are any, a network got and took for nothing."""
        unseen = np.array([group.lidar < 0 for group in self.associations])
        return unseen & in_reach(self.targets.center_m) & self.observations.with_echoes


def probabilities(evidence: Evidence, sensors: SensorReliability, params: FusionParams) -> Float64:
    """Probability (N,) of each object; `sensors` learns from this frame first.

    It learns from the objects that are probable even though a sensor that should doesn't see them, so that a sensor
    with false alarms doesn't make the others look blind.
    """
    seen = evidence.observations
    obstacles = seen.lidar.measured_xyz  # that hide what is behind them: points as high as cars
    if seen.plane is not None:
        height = obstacles[:, 2] - seen.plane.z_m(obstacles)
        obstacles = obstacles[(height > _HIDES_M[0]) & (height < _HIDES_M[1])]
    witnesses = [_camera_witness(evidence, name, obstacles, params) for name in seen.working]
    if seen.with_echoes or len(seen.lidar.all_xyz) + len(seen.lidar.boxes):
        witnesses.append(_lidar_witness(evidence, obstacles, params))
    if len(seen.radar.all_xyz) + len(seen.radar.boxes):
        witnesses.append(_radar_witness(evidence, obstacles, params))
    sure = sureness(_probabilities(evidence, witnesses, sensors, params))
    for w in witnesses:
        sensors.learn(w.name, evidence.distance_m, sure * w.could, w.seen)
    return _probabilities(evidence, witnesses, sensors, params)


_RULED_WEIGHT, _RULED_ALONE = 0.5, 0.65


def resolve_weight(params: FusionParams, judge: str | None, has_camera: bool) -> FusionParams:
    """Return parameters that say how far scores of LiDAR clusters that were judged so are believed."""
    if params.lidar_weight is not None:
        return params
    ruled = _RULED_WEIGHT if has_camera else _RULED_ALONE
    return replace(params, lidar_weight=1.0 if judge == "model" else ruled)


def believe_lidar(lidar: Clusters, params: FusionParams) -> Float64:
    """Probabilities (K,) for which scores of LiDAR clusters stand."""
    weight = _RULED_WEIGHT if params.lidar_weight is None else params.lidar_weight
    return np.asarray(weight * lidar.score, np.float64)


def _probabilities(
    evidence: Evidence, witnesses: list[Witness], sensors: SensorReliability, params: FusionParams
) -> Float64:
    distance, groups, ignored = evidence.distance_m, evidence.associations, evidence.ignored
    shown = np.array([bool(group.cameras) for group in groups])
    unplaced = np.array([bool(group.cameras) and group.lidar < 0 for group in groups])
    believed = params.standing_weight * saturate(evidence.standing, params.full_points)
    standing = np.where(evidence.standing > 0, np.maximum(_add_odds(believed, params), 0.0), 0.0)
    odds = log_odds(params.prior, 1e-6) + np.where(unplaced & ~ignored, standing, 0.0)
    seen_by, added_by, could_by = list[Bool](), list[Float64](), list[Float64]()
    for w in witnesses:
        share = np.minimum(sensors.share(w.name, w.kind, distance) * w.could, params.max_detection)
        seen = np.where(shown, w.confirmed_odds, w.odds) + np.log(np.maximum(w.could, params.unlikely))
        silent = np.log1p(-share)
        if w.kind == "camera" and evidence.observations.learned:
            # Weak boxes mostly lie in surer ones, which may hide what they show: they say no less than none would.
            seen = np.maximum(seen, silent)
        if w.kind == "radar":
            seen = np.where(ignored, np.minimum(seen, silent), seen)
        added = np.where(w.seen, seen, silent)
        if w.kind == "camera":
            seen_by.append(w.seen)
            added_by.append(added)
            could_by.append(w.could)
        else:
            odds += added
    if not seen_by:
        return probability_of(odds)
    return probability_of(odds + join_cameras(np.array(seen_by), np.array(added_by), np.array(could_by)))


def join_cameras(seen: Bool, added: Float64, could: Float64) -> Float64:
    """Evidence (N,) of C cameras together, given which see the objects (C, N), what each adds to the log-odds by seeing
    or missing them, and how far it could see them.

    Cameras see much the same picture and share their mistakes, so that one opinion told thrice counts once: the mean of
    those that see an object counts, and of those that should and don't as much as is their share.
    """
    weight = np.maximum(could, 1e-3)
    by_seen, by_unseen = np.where(seen, weight, 0.0), np.where(seen, 0.0, weight)
    means = [(by * added).sum(axis=0) / np.maximum(by.sum(axis=0), 1e-9) for by in (by_seen, by_unseen)]
    return np.asarray(means[0] + means[1] * by_unseen.sum(axis=0) / weight.sum(axis=0), np.float64)


def _camera_witness(evidence: Evidence, name: str, obstacles: Float64, params: FusionParams) -> Witness:
    """A working camera sees half of the objects that are `camera_height_px` high, and none outside of its image."""
    observations, targets, rig = evidence.observations.cameras, evidence.targets, evidence.observations.rig
    own = [next((i for i in g.cameras if observations[i].camera == name), -1) for g in evidence.associations]
    score = np.array([observations[i].score if i >= 0 else 0.0 for i in own])
    boxes = [s for s in observations if s.camera == name and s.is_sure]
    seen = np.array(own) >= 0
    open_share = 1 - _occlusion_shares(targets, rig.body_T_sensor(name)[:2, 3], obstacles, boxes)
    uv, depth = project_body(rig, name, targets.center_m)
    model = rig.cameras[name]
    height = model.K[1, 1] * targets.size_lwh_m[:, 2] / np.maximum(depth, 0.1)
    share = expected_share(height, params.camera_height_px)
    could = np.where(in_image(model, uv), share, 0.0) * open_share
    # How much better than half the objects that LiDAR places cover the camera's boxes.
    fits = np.zeros(len(own))
    rows = np.array([i for i, g in enumerate(evidence.associations) if own[i] >= 0 and g.lidar >= 0], np.int64)
    if len(rows):
        fits[rows] = outline_overlaps(rig, name, targets[rows], np.array([observations[own[i]].xyxy_px for i in rows]))
        fits[rows] -= 0.5
    odds = _add_odds(score, params) + params.overlap * fits
    return Witness(name, "camera", seen, odds, odds, np.where(seen, open_share, could))


def _lidar_witness(evidence: Evidence, obstacles: Float64, params: FusionParams) -> Witness:
    lidar, eye = evidence.observations.lidar, evidence.observations.lidar_eye_m
    at = np.array([g.lidar for g in evidence.associations], np.int64)
    seen, points = at >= 0, np.append(lidar.num_points, 0.0)[at]
    # A cluster that is cut says nothing about its parts' shape.
    whole = np.array([not g.is_cut for g in evidence.associations])
    score = np.where(whole, np.append(believe_lidar(lidar, params), 0.0)[at], 0.0)
    confirmed = params.confirmed_lidar * saturate(points, params.full_points)
    half, where = params.lidar_half_m or _HALF_M, lidar.all_xyz
    reach = np.ones(len(seen), np.bool_)
    if evidence.observations.with_echoes:
        half, reach = params.lidar_half_m or _HALF_WITH_ECHOES_M, in_reach(evidence.targets.center_m)
        where = np.concatenate([where, evidence.observations.radar.all_xyz])
    dense = reach / (1 + (evidence.distance_m / half) ** 4)
    could = dense * _open_shares(evidence, eye, where, obstacles, params)
    odds, confirmed_odds = _add_odds(score, params), _add_odds(np.maximum(score, confirmed), params)
    return Witness("lidar", "lidar", seen, odds, confirmed_odds, np.where(seen, 1.0, could))


def _radar_witness(evidence: Evidence, obstacles: Float64, params: FusionParams) -> Witness:
    radar, eye = evidence.observations.radar, evidence.observations.radar_eye_m
    at = np.array([g.radar for g in evidence.associations], np.int64)
    velocity = radar.boxes.velocity_mps
    moves = np.zeros(len(radar.boxes), np.bool_) if velocity is None else np.isfinite(velocity).any(axis=1)
    weight = np.where(moves, params.radar_weight, params.standing_weight)
    sure = np.where(moves, params.confirmed_radar, params.standing_weight)
    score = np.append(weight * radar.score, 0.0)[at]
    confirmed = np.append(sure * saturate(radar.num_points, params.full_points), 0.0)[at]
    could = _open_shares(evidence, eye, radar.all_xyz, obstacles, params)
    odds, confirmed_odds = _add_odds(score, params), _add_odds(np.maximum(score, confirmed), params)
    return Witness("radar", "radar", at >= 0, odds, confirmed_odds, could)


def _occlusion_shares(targets: Boxes3D, eye_m: Float64, points: Float64, boxes: list[CameraObservation]) -> Float64:
    """Share (N,) of objects' widths hidden from `eye_m` (2,) by nearer points (M, 3), or what a camera there sees."""
    nearest = nearest_by_bearing(np.ascontiguousarray(points[:, :2] - eye_m), _BINS)
    for s in boxes:
        begin, end = (int(np.floor(_bin(np.array(s.bearing_rad + side * s.half_rad)))) for side in (-1, 1))
        rows = np.arange(begin, end + 1) % _BINS
        nearest[rows] = np.minimum(nearest[rows], s.near_m * (1 + 2 * s.std))
    off = targets.center_m[:, :2] - eye_m
    reach = np.maximum(np.hypot(off[:, 0], off[:, 1]), 0.1)
    half_rad = targets.size_lwh_m[:, 1] / 2 / np.maximum(reach, 1.0)
    near = reach - targets.size_lwh_m[:, 0] / 2 - _BEHIND_M
    return occlusion_shares(nearest, np.arctan2(off[:, 1], off[:, 0]), half_rad, near)


def _open_shares(
    evidence: Evidence, eye_m: Float64, points: Float64, obstacles: Float64, params: FusionParams
) -> Float64:
    """Share (N,) of objects' widths that a sensor at `eye_m` (2,) sees past obstacles (K, 3), of those that are near,
    and in a direction in which it has points (M, 3).
    """
    center = evidence.targets.center_m
    seen = np.isfinite(nearest_by_bearing(np.ascontiguousarray(points[:, :2] - eye_m), _SECTORS))
    seen = np.any([np.roll(seen, shift) for shift in (-2, -1, 0, 1, 2)], axis=0)
    at = np.arctan2(center[:, 1] - eye_m[1], center[:, 0] - eye_m[0])
    in_sector = seen[(_bin(at) / _BINS * _SECTORS).astype(np.int64) % _SECTORS]
    in_view = in_sector & (evidence.distance_m < params.max_range_m)
    return np.asarray(in_view * (1 - _occlusion_shares(evidence.targets, eye_m, obstacles, [])), np.float64)


def _bin(angle_rad: Float64) -> Float64:
    return np.asarray((angle_rad + np.pi) / (2 * np.pi) * _BINS, np.float64)


def _add_odds(probability: Float64, params: FusionParams) -> Float64:
    """Log-odds that a sensor adds that by itself would make it this probable."""
    return np.asarray(log_odds(probability) - log_odds(params.prior, 1e-6), np.float64)
