"""Existence of objects: by the sensors that see them and those that should and don't."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.fusion.kernels import hidden_shares, nearest_by_bearing
from fbench.pipelines.fusion.late.association import Group
from fbench.pipelines.fusion.late.params import AgreementParams, FusionParams
from fbench.pipelines.fusion.late.place import Scene
from fbench.pipelines.fusion.observations import Sighting, outline_overlaps
from fbench.pipelines.sensors.points.ground import Plane
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import in_image, project_body

_BANDS = 4


class Agreement:
    """Counts, for each sensor and band of distance, sure objects that it should have seen, and those that it saw."""

    def __init__(self, params: AgreementParams) -> None:
        self._params = params
        self._counts: dict[str, Float64] = {}

    def reset(self) -> None:
        """Expect of all sensors what is expected of them at the start."""
        self._counts = {}

    def share(self, sensor: str, kind: str, distance_m: Float64) -> Float64:
        """Share (N,) of the objects at these distances that a sensor sees where nothing hides them."""
        p = self._params
        expected = {"camera": p.camera, "lidar": p.lidar, "radar": p.radar}[kind]
        seen, asked = self._counts.get(sensor, np.zeros((2, _BANDS)))
        shares = (seen + p.weight * expected) / (asked + p.weight)
        return np.asarray(shares[self._band(distance_m)], np.float64)

    def observe(self, sensor: str, distance_m: Float64, sure: Float64, seen: Bool) -> None:
        """Take in one frame: how sure others are (N,) of objects that the sensor should see, and whether it did."""
        band = self._band(distance_m)
        asked = np.bincount(band, weights=sure, minlength=_BANDS)
        hits = np.bincount(band, weights=sure * seen, minlength=_BANDS)
        before = self._counts.get(sensor, np.zeros((2, _BANDS)))
        self._counts[sensor] = before * np.exp(-1.0 / self._params.frames) + np.array([hits, asked])

    def _band(self, distance_m: Float64) -> Int64:
        return np.minimum(distance_m / self._params.band_m, _BANDS - 1).astype(np.int64)


_BINS = 720
_SECTORS = 36
_HIDES_M = (0.5, 2.2)
_BEHIND_M = 1.5
_STEEPNESS = 2.0


def blocking(xyz: Float64, plane: Plane | None) -> Float64:
    """Points (M, 3) of those (N, 3) that hide what is behind them: as high as cars."""
    if plane is None:
        return xyz
    height = xyz[:, 2] - plane.z_m(xyz)
    return xyz[(height > _HIDES_M[0]) & (height < _HIDES_M[1])]


def hidden(targets: Boxes3D, eye_m: Float64, points: Float64, boxes: list[Sighting]) -> Float64:
    """Share (N,) of each object's width that something nearer hides from `eye_m` (2,): LiDAR points (M, 3), or what
    a camera there sees.
    """
    nearest = nearest_by_bearing(np.ascontiguousarray(points[:, :2] - eye_m), _BINS)
    for s in boxes:
        begin, end = (int(np.floor(_bin(np.array(s.bearing_rad + side * s.half_rad)))) for side in (-1, 1))
        rows = np.arange(begin, end + 1) % _BINS
        nearest[rows] = np.minimum(nearest[rows], s.near_m * (1 + 2 * s.std))
    off = targets.center_m[:, :2] - eye_m
    reach = np.maximum(np.hypot(off[:, 0], off[:, 1]), 0.1)
    half_rad = targets.size_lwh_m[:, 1] / 2 / np.maximum(reach, 1.0)
    near = reach - targets.size_lwh_m[:, 0] / 2 - _BEHIND_M
    return hidden_shares(nearest, np.arctan2(off[:, 1], off[:, 0]), half_rad, near)


def in_camera(rig: Rig, camera: str, targets: Boxes3D, half_px: float) -> Float64:
    """Probability (N,) that a working camera sees objects that nothing hides: 0 outside of its image, one half where
    they are `half_px` high.
    """
    uv, depth = project_body(rig, camera, targets.center_m)
    model = rig.cameras[camera]
    height = model.K[1, 1] * targets.size_lwh_m[:, 2] / np.maximum(depth, 0.1)
    share = 1 / (1 + (half_px / np.maximum(height, 1e-3)) ** (2 * _STEEPNESS))
    return np.where(in_image(model, uv), share, 0.0)


def in_sectors(targets: Boxes3D, eye_m: Float64, points: Float64) -> Bool:
    """Tell which objects (N,) lie in a direction in which a sensor at `eye_m` (2,) sees anything: its points (M, 3)."""
    off = points[:, :2] - eye_m
    seen = np.isfinite(nearest_by_bearing(np.ascontiguousarray(off), _SECTORS))
    seen = np.any([np.roll(seen, shift) for shift in (-2, -1, 0, 1, 2)], axis=0)
    at = np.arctan2(targets.center_m[:, 1] - eye_m[1], targets.center_m[:, 0] - eye_m[0])
    return np.asarray(seen[(_bin(at) / _BINS * _SECTORS).astype(np.int64) % _SECTORS], np.bool_)


def _bin(angle_rad: Float64) -> Float64:
    return np.asarray((angle_rad + np.pi) / (2 * np.pi) * _BINS, np.float64)


_SURE = 0.98


@dataclass(frozen=True, eq=False)
class Witness:
    """What one sensor says about N objects."""

    name: str
    kind: str
    seen: Bool
    """(N,) whether it sees them."""
    odds: Float64
    """(N,) what it adds to their log-odds where it does, if nothing else is known."""
    confirmed_odds: Float64
    """(N,) the same where a camera sees them, too."""
    could: Float64
    """(N,) probability that a sensor that works sees them."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """All that fusion knows of the groups of one frame."""

    rig: Rig
    cameras: tuple[str, ...]
    """Those that worked."""
    scene: Scene
    groups: list[Group]
    targets: Boxes3D
    """(N) what may be there, in body coordinates."""
    standing: Float64
    """(N,) number of stationary echoes at the place of each object."""
    radar_eye_m: Float64
    """(2,) [m]."""
    obstacles: Float64
    """(M, 3) LiDAR points that hide what is behind them [m], see `blocking`."""


def probabilities(evidence: Evidence, agreement: Agreement, params: FusionParams) -> Float64:
    """Probability (N,) of each object; `agreement` learns from this frame first.

    It learns from the objects that are probable even though a sensor that should doesn't see them, so that a sensor
    with false alarms doesn't make the others look blind.
    """
    witnesses = _witnesses(evidence, params)
    probable = _judged(evidence, witnesses, agreement, params)
    sure = np.clip(2 * probable - 1, 0.0, 1.0)
    for w in witnesses:
        agreement.observe(w.name, _reach(evidence), sure * w.could, w.seen)
    return _judged(evidence, witnesses, agreement, params)


def lidar_weight(scene: Scene, params: FusionParams) -> float:
    """How far the scores of LiDAR clusters are believed."""
    return params.lidar_weight if scene.lidar.are_judged_by_model else params.ruled_weight


def _judged(evidence: Evidence, witnesses: list[Witness], agreement: Agreement, params: FusionParams) -> Float64:
    reach, shown = _reach(evidence), np.array([bool(group.sightings) for group in evidence.groups])
    unplaced = np.array([bool(g.sightings) and g.lidar < 0 for g in evidence.groups])
    odds = _logit(params.prior) + np.where(unplaced, _standing(evidence, params), 0.0)
    of_cameras = []
    for w in witnesses:
        share = np.minimum(agreement.share(w.name, w.kind, reach) * w.could, params.max_detection)
        seen = np.where(shown, w.confirmed_odds, w.odds) + np.log(np.maximum(w.could, params.unlikely))
        added = np.where(w.seen, seen, np.log1p(-share))
        if w.kind == "camera":
            of_cameras.append((w.seen, added))
        else:
            odds += added
    return np.asarray(1 / (1 + np.exp(-odds - _of_cameras(of_cameras, len(reach)))), np.float64)


def _of_cameras(said: list[tuple[Bool, Float64]], num: int) -> Float64:
    """What cameras add (N,): they see much the same picture, so that the surest that sees an object counts, and where
    none does the surest that should.
    """
    if not said:
        return np.zeros(num)
    seen, added = np.array([s for s, _ in said]), np.array([a for _, a in said])
    best = np.where(seen, added, -np.inf).max(axis=0)
    return np.asarray(np.where(seen.any(axis=0), best, added.min(axis=0)), np.float64)


def _witnesses(evidence: Evidence, params: FusionParams) -> list[Witness]:
    result = [_camera(evidence, name, params) for name in evidence.cameras]
    lidar, radar = evidence.scene.lidar, evidence.scene.radar
    if len(lidar.xyz) + len(lidar.loose) + len(lidar.boxes):
        result.append(_lidar(evidence, params))
    if len(radar.xyz) + len(radar.loose) + len(radar.boxes):
        result.append(_radar(evidence, params))
    return result


def _camera(evidence: Evidence, name: str, params: FusionParams) -> Witness:
    scene, groups = evidence.scene, evidence.groups
    own = [next((i for i in g.sightings if scene.sightings[i].camera == name), -1) for g in groups]
    score = np.array([scene.sightings[i].score if i >= 0 else 0.0 for i in own])
    boxes = [s for s in scene.sightings if s.camera == name and s.is_sure]
    eye = evidence.rig.body_T_sensor(name)[:2, 3]
    covered = hidden(evidence.targets, eye, evidence.obstacles, boxes)
    seen, open_share = np.array(own) >= 0, 1 - covered
    could = in_camera(evidence.rig, name, evidence.targets, params.camera_height_px) * open_share
    odds = _added(score, params) + params.overlap * _fits(evidence, name, own)
    return Witness(name, "camera", seen, odds, odds, np.where(seen, open_share, could))


def _fits(evidence: Evidence, name: str, own: list[int]) -> Float64:
    """How much better than half (N,) the objects that LiDAR places cover the boxes `own` of a camera; 0 for others."""
    rows = np.array([i for i, g in enumerate(evidence.groups) if own[i] >= 0 and g.lidar >= 0], np.int64)
    result = np.zeros(len(own))
    if len(rows):
        boxes = np.array([evidence.scene.sightings[own[i]].xyxy_px for i in rows])
        result[rows] = outline_overlaps(evidence.rig, name, evidence.targets[rows], boxes) - 0.5
    return result


def _lidar(evidence: Evidence, params: FusionParams) -> Witness:
    scene = evidence.scene
    at = np.array([g.lidar for g in evidence.groups], np.int64)
    seen = at >= 0
    # A cluster that is cut says nothing about its parts' shape.
    whole = np.array([not g.is_cut for g in evidence.groups])
    score = np.zeros(len(at))
    score[seen] = scene.lidar.score[at[seen]]
    score = lidar_weight(scene, params) * np.where(whole, score, 0.0)
    points = np.zeros(len(at))
    points[seen] = scene.lidar.num_points[at[seen]]
    confirmed = params.confirmed_lidar * (1 - np.exp(-points / params.full_points))
    covered = hidden(evidence.targets, scene.lidar_eye_m, evidence.obstacles, [])
    everything = np.concatenate([scene.lidar.xyz, scene.lidar.loose])
    could = in_sectors(evidence.targets, scene.lidar_eye_m, everything) & _is_near(evidence, params)
    dense = 1 / (1 + (_reach(evidence) / params.lidar_half_m) ** 4)
    return Witness(
        "lidar", "lidar", seen, _added(score, params), _added(np.maximum(score, confirmed), params),
        np.where(seen, 1.0, could * dense * (1 - covered)),
    )  # fmt: skip


def _radar(evidence: Evidence, params: FusionParams) -> Witness:
    radar = evidence.scene.radar
    at = np.array([g.radar for g in evidence.groups], np.int64)
    seen = at >= 0
    velocity = radar.boxes.velocity_mps
    moves = np.zeros(len(radar.boxes), np.bool_) if velocity is None else np.isfinite(velocity).any(axis=1)
    weight = np.where(moves, params.radar_weight, params.standing_weight)
    sure = np.where(moves, params.confirmed_radar, params.standing_weight)
    score, confirmed = np.zeros(len(at)), np.zeros(len(at))
    score[seen] = (weight * radar.score)[at[seen]]
    confirmed[seen] = (sure * (1 - np.exp(-radar.num_points / params.full_points)))[at[seen]]
    eye = evidence.radar_eye_m
    covered = hidden(evidence.targets, eye, evidence.obstacles, [])
    everything = np.concatenate([radar.xyz, radar.loose])
    could = in_sectors(evidence.targets, eye, everything) & _is_near(evidence, params)
    return Witness(
        "radar", "radar", seen, _added(score, params), _added(np.maximum(score, confirmed), params),
        could * (1 - covered),
    )  # fmt: skip


def _standing(evidence: Evidence, params: FusionParams) -> Float64:
    believed = params.standing_weight * (1 - np.exp(-evidence.standing / params.full_points))
    return np.where(evidence.standing > 0, np.maximum(_added(believed, params), 0.0), 0.0)


def _is_near(evidence: Evidence, params: FusionParams) -> Bool:
    return np.asarray(_reach(evidence) < params.max_range_m, np.bool_)


def _reach(evidence: Evidence) -> Float64:
    center = evidence.targets.center_m
    return np.asarray(np.hypot(center[:, 0], center[:, 1]), np.float64)


def _added(probability: Float64, params: FusionParams) -> Float64:
    """Log-odds that a sensor adds that by itself would make it this probable."""
    p = np.clip(probability, 1 - _SURE, _SURE)
    return np.asarray(np.log(p / (1 - p)) - _logit(params.prior), np.float64)


def _logit(probability: float) -> float:
    p = min(max(probability, 1e-6), 1 - 1e-6)
    return float(np.log(p / (1 - p)))
