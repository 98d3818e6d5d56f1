"""Joint observations: what several cameras see of one object is one piece of evidence."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.pipelines.fusion.kernels import agglomerate
from fbench.pipelines.fusion.observations import AT_MIN_SCORE, AssociationParams, CameraObservation
from fbench.pipelines.sensors.odds import log_odds, probability_of
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import VEHICLES
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import in_image, project_body, rays
from fbench.replay.geometry.transforms import wrap_angle

UNREPORTED = 0.2
"""How likely what a camera ought to see and doesn't report at all is there by that camera."""
_TWO_WHEELS = ["bicycle", "motorcycle"]
_HALF_SEEN_PX, _STEEPNESS = 12.0, 4.0
_LEAST = 1e-6


def expected_share(height_px: Float64, half_px: float = _HALF_SEEN_PX) -> Float64:
    """Share (N,) of objects so high [px] that a camera sees, which sees every second one that is `half_px` high."""
    return np.asarray(1 / (1 + (half_px / np.maximum(height_px, 1e-3)) ** _STEEPNESS), np.float64)


def camera_ratios(seen: Sequence[CameraObservation], params: AssociationParams) -> Float64:
    """Log-likelihood ratios (S, S) that pairs show one object, as the camera of the row sees it: directions are sure,
    distances aren't. Vehicles are easily taken for each other, and so are things with two wheels; -inf for other kinds,
    and two boxes of one camera.
    """
    camera, label = np.array([s.camera for s in seen], np.str_), np.array([s.label for s in seen], np.str_)
    eye = np.array([s.eye_m[:2] for s in seen], np.float64).reshape(-1, 2)
    table = [(s.bearing_rad, s.near_m + s.depth_m, s.std, s.half_rad) for s in seen]
    bearing, middle, std, half = np.array(table, np.float64).reshape(-1, 4).T
    place = eye + np.column_stack([np.cos(bearing), np.sin(bearing)]) * middle[:, None]
    off = place[None, :] - eye[:, None]
    reach, direction = np.maximum(np.hypot(off[..., 0], off[..., 1]), 0.1), np.arctan2(off[..., 1], off[..., 0])
    both = np.hypot(std[:, None], std[None, :])
    aside = half[:, None] / 2 + 2 * params.bearing_std_rad
    beside = wrap_angle(direction - bearing[:, None])
    square = (np.log(reach / middle[:, None]) / both) ** 2 + (beside / aside) ** 2
    ratio = np.log(params.camera_area_m2 / (reach**2 * 2 * np.pi * both * aside)) - square / 2
    alike = label[:, None] == label
    for kind in (list(VEHICLES), _TWO_WHEELS):
        is_of_kind = np.isin(label, kind)
        alike |= is_of_kind[:, None] & is_of_kind
    return np.where(alike & (camera[:, None] != camera), ratio, -np.inf)


@dataclass(frozen=True, eq=False)
class JointObservations:
    """Which of S observations show one object, and how likely all cameras together make it."""

    number: Int64  # (S,) the first observation of the same object
    score: Float64  # (S,) probability of the object of each, see `join_observations`
    is_sure: Bool  # (S,) whether the cameras together would report it
    near_m: Float64  # (S,) distance of the near side from the camera of each [m], as all cameras together guess it


def join_observations(
    rig: Rig, working: Sequence[str], seen: Sequence[CameraObservation], params: AssociationParams
) -> JointObservations:
    """Find which observations of working cameras show one object.

    Cameras whose views overlap see the same picture, and share their mistakes. How likely an object is follows from the
    mean of the log-odds of those that see it and those that ought to, which count as `UNREPORTED`: a logarithmic
    opinion pool (Genest and Zidek, Statistical Science 1986), by which one opinion told thrice counts once.
    """
    score, is_sure = np.array([s.score for s in seen], np.float64), np.array([s.is_sure for s in seen], np.bool_)
    number, near = np.arange(len(seen)), np.array([s.near_m for s in seen], np.float64)
    if len(working) < 2 or not len(seen):
        return JointObservations(number, score, is_sure, near)
    # Weak boxes, such as second ones of one thing, mustn't take what surer ones may have.
    weakness = np.maximum(log_odds(AT_MIN_SCORE) - log_odds(score), 0.0)
    upper = np.triu(camera_ratios(seen, params) - weakness[:, None] - weakness, 1)
    number = agglomerate(upper + upper.T)
    camera = np.array([working.index(s.camera) for s in seen])
    expected = _expected_shares(rig, working, seen)
    expected[np.arange(len(seen)), camera] = 1.0
    opinions = np.full(expected.shape, log_odds(UNREPORTED))
    opinions[np.arange(len(seen)), camera] = log_odds(score, _LEAST)
    for one in np.unique(number):
        rows = np.flatnonzero(number == one)
        weight, opinion = expected[rows].max(axis=0), opinions[rows].max(axis=0)
        weight[camera[rows]] = 1.0
        opinion[camera[rows]] = opinions[rows, camera[rows]]
        if np.count_nonzero(weight) > 1:
            score[rows] = probability_of((weight * opinion).sum(keepdims=True) / weight.sum())
            near[rows] = _join_distances([seen[at] for at in rows.tolist()])
            is_sure[rows] = is_sure[rows].any() and score[rows[0]] >= AT_MIN_SCORE
    return JointObservations(number, score, is_sure, near)


def _join_distances(seen: Sequence[CameraObservation]) -> Float64:
    """Distances (M,) of the near side of one object from the cameras that see it [m]: means of the logarithms of what
    all guess, weighted by their errors.
    """
    rays = np.array([[np.cos(s.bearing_rad), np.sin(s.bearing_rad)] for s in seen])
    eye, weight = np.array([s.eye_m[:2] for s in seen]), np.array([s.std**-2 for s in seen])
    off = eye + rays * np.array([s.near_m for s in seen])[:, None] - eye[:, None]
    guess = np.log(np.maximum(np.hypot(off[..., 0], off[..., 1]), 0.1))
    return np.asarray(np.exp((guess * weight).sum(axis=1) / weight.sum()), np.float64)


def _expected_shares(rig: Rig, working: Sequence[str], seen: Sequence[CameraObservation]) -> Float64:
    """How far each camera (C) ought to see what each observation (S, C) shows: 0 out of its image, and where something
    hides it that the camera is sure of.
    """
    place = np.array([_locate(rig, s) for s in seen]).reshape(-1, 3)
    height_m = np.array([s.size_lwh_m[2] for s in seen], np.float64)
    result = np.zeros((len(seen), len(working)))
    for at, name in enumerate(working):
        uv, depth = project_body(rig, name, place)
        eye, model = rig.body_T_sensor(name)[:3, 3], rig.cameras[name]
        share = expected_share(model.K[1, 1] * height_m / np.maximum(depth, 0.1))
        result[:, at] = np.where(in_image(model, uv), share, 0.0)
        distance = np.hypot(place[:, 0] - eye[0], place[:, 1] - eye[1])
        for s in seen:
            if s.camera == name and s.is_sure:
                left, top, right, bottom = s.xyxy_px
                inside = (uv[:, 0] > left) & (uv[:, 0] < right) & (uv[:, 1] > top) & (uv[:, 1] < bottom)
                result[inside & (distance > s.near_m * (1 + 2 * s.std) + 2 * s.depth_m), at] = 0.0
    return result


def _locate(rig: Rig, one: CameraObservation) -> Float64:
    """Middle (3,) of what a camera sees, along the ray through the middle of its box, in body coordinates [m]."""
    left, top, right, bottom = one.xyxy_px
    ray = rays(rig.cameras[one.camera], np.array([[(left + right) / 2, (top + bottom) / 2]]))[0]
    ray = (rig.body_T_sensor(one.camera)[:3, :3] * ray).sum(axis=1)
    place: Float64 = one.eye_m + ray * (one.near_m + one.depth_m) / max(float(np.hypot(ray[0], ray[1])), 1e-3)
    return place
