"""Places of boxes in the world, and which truth boxes some sensor sees."""

from collections.abc import Callable, Hashable, Sequence
from functools import cached_property
from typing import TypeVar, cast

import numpy as np

from fbench.metrics.runs.columns import Labelled
from fbench.replay.contracts.errors import ConfigError, did_you_mean
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes, Boxes2D, Boxes3D, finite
from fbench.replay.data.metadata import Region, inside
from fbench.replay.data.rig import Rig
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.geometry.camera import not_projectable, rays
from fbench.replay.geometry.transforms import pose_matrices
from fbench.replay.runs.folder import Run

T = TypeVar("T")


class SharedRun(Run):
    """A run that keeps what is derived of it for as long as it lives; metrics that don't know of it see a run."""

    @cached_property
    def cache(self) -> dict[Hashable, object]:
        """By what it is and all that it depends on."""
        return {}


def once(run: Run, key: Hashable, make: Callable[[], T]) -> T:
    """Return what `make` returns; of a shared run it is called for the first time only."""
    if not isinstance(run, SharedRun):
        return make()
    if key not in run.cache:
        run.cache[key] = make()
    return cast(T, run.cache[key])


SHOWN_FROM = 0.4
"""Visible share from which on a camera shows a box where truth in images doesn't tell: nuScenes' lowest bin, which ends
there, also holds what shows nothing.
"""
_UNSEEN, _UNTOLD, _SEEN = 0, 1, 2  # What a kind of sensor tells of a box; of several kinds the highest counts


def find_seen(labeled: Labelled, frame: Int64, truth: Boxes3D, options: ScoreOptions) -> Bool | None:
    """Tell which truth boxes (N,) at least one sensor of the log sees, whatever the pipeline got; `None` where truth
    doesn't tell.

    A LiDAR or radar sees what it has a point on, or as many as the options ask for. A camera sees what truth in its
    images shows and doesn't ignore; where no image has truth, that of which at least `SHOWN_FROM` is visible. A box
    counts as seen unless every kind of sensor that the rig has tells that it doesn't see it.

    `frame` (N,) is which of the run's frames with 3D truth each box belongs to. Raises ConfigError where only what is
    seen is to be scored, and truth doesn't tell.
    """
    answers = {"camera": _in_images(labeled, frame, truth)}
    for kind, points in (("lidar", truth.num_lidar_pts), ("radar", truth.num_radar_pts)):
        known = np.full(len(truth), -1) if points is None else points
        answers[kind] = _answers(known >= max(options.seen, 1), known >= 0)
    found, is_told = np.full(len(truth), _UNTOLD, np.int8), True
    for rig, rows in labeled.rigs(frame):
        kinds = {mount.kind for mount in rig.mounts.values()}
        own = [answer for kind, answer in answers.items() if kind in kinds]
        found[rows] = np.max([answer[rows] for answer in own], axis=0, initial=_UNTOLD if not own else _UNSEEN)
        is_told &= bool(own) and all((answer != _UNTOLD).any() for answer in own)
    if is_told or (found == _SEEN).all():
        return np.asarray(found > _UNSEEN)
    if options.seen:
        raise ConfigError(
            f"log '{labeled.run.manifest.log.name}': its truth doesn't tell of each kind of sensor what that sees "
            "(num_lidar_pts, num_radar_pts, and boxes in images or visibility); score without --seen"
        )
    return None


def _answers(seen: Bool, unseen: Bool) -> Array:
    """What a kind of sensor tells of each box (N,)."""
    return np.select([seen, unseen], [_SEEN, _UNSEEN], _UNTOLD).astype(np.int8)


def _in_images(labeled: Labelled, frame: Int64, truth: Boxes3D) -> Array:
    run = labeled.run
    with_images = [record.index for record in run.frames if "2d" in record.truth_spaces.split()]
    if not with_images:
        share = np.full(len(truth), np.nan) if truth.visibility is None else truth.visibility
        return _answers(share >= SHOWN_FROM, share < SHOWN_FROM)
    own = np.column_stack([labeled.indices[frame], _ids(truth)])
    table = run.truth_table("2d")
    shown = _ids(table.boxes) >= 0
    if table.boxes.ignore is not None:
        shown &= ~table.boxes.ignore
    others = np.column_stack([table.frames, _ids(table.boxes)])[shown]
    number = np.unique(np.concatenate([own, others]), axis=0, return_inverse=True)[1].reshape(-1)
    is_shown = np.isin(number[: len(own)], number[len(own) :])
    return _answers(is_shown, np.isin(own[:, 0], with_images) & (own[:, 1] >= 0))


def _ids(boxes: Boxes) -> Int64:
    return np.full(len(boxes), -1) if boxes.track_id is None else boxes.track_id


def has_poses(run: Run) -> bool:
    """Whether all frames of a run have a pose."""
    return bool(np.isfinite(run.poses).all())


def regions_of(run: Run) -> tuple[Region, ...]:
    """The regions of a run's log."""
    return once(run, "regions", lambda: run.manifest.log_info.regions)


def ground_points(run: Run, frame: Int64, center_m: Float64) -> Float64:
    """Return x, y (N, 2) [m] in the world of points (N, 3) on the body at frames (N,) by index; inf: not finite."""
    frames, at = np.unique(frame, return_inverse=True)
    row_of = {record.index: row for row, record in enumerate(run.frames)}
    poses = run.poses[[row_of[index] for index in frames.tolist()]]
    world_T_body = pose_matrices(poses[:, :3], poses[:, 3:])[at]
    x, y = ((world_T_body[:, axis, :3] * center_m).sum(axis=1) + world_T_body[:, axis, 3] for axis in (0, 1))
    return np.asarray(np.nan_to_num(np.column_stack([x, y]), nan=np.inf), np.float64)


def on_ground(run: Run, kinds: Sequence[str], frame: Int64, center_m: Float64) -> Bool:
    """Tell which points (N, 3), as in `ground_points`, lie in a region of these kinds. Raises ConfigError where the log
    has no such kind, or no poses, so that nobody knows where boxes are in the world.
    """
    regions = regions_of(run)
    known = list(dict.fromkeys(region.kind for region in regions))
    for kind in kinds:
        if kind not in known:
            raise ConfigError(f"log '{run.manifest.log.name}' has no region '{kind}'{did_you_mean(kind, known)}")
    if not has_poses(run):
        why = "doesn't tell where the body was, so that its regions can't be used; score without --region"
        raise ConfigError(f"log '{run.manifest.log.name}' {why}")
    chosen = [region for region in regions if region.kind in kinds]
    return np.asarray(inside(chosen, ground_points(run, frame, center_m)), bool)


GROUND_WITHIN_M = 20.0
"""So near to the body, in the ground plane, truth boxes tell how high the ground is: farther off it may be hilly."""


def ground_height(run: Run) -> float:
    """Return how high the ground is in body coordinates [m], below 0 where the body's origin is above it: the median of
    the lower ends of near truth boxes of road users, `other` left out; 0 where there are none.
    """

    def find() -> float:
        boxes = run.truth_table("3d").boxes
        if not isinstance(boxes, Boxes3D):
            return 0.0
        good = finite(boxes)[0]
        good[good] = np.hypot(boxes.center_m[good, 0], boxes.center_m[good, 1]) <= GROUND_WITHIN_M
        if boxes.label is not None:
            good &= boxes.label != "other"
        low_m = boxes.center_m[good, 2] - boxes.size_lwh_m[good, 2] / 2
        return float(np.median(low_m)) if len(low_m) else 0.0

    return once(run, "ground height", find)


def place_in_space(rig: Rig, boxes: Boxes2D, ground_m: float) -> Float64:
    """Return where boxes in images (N,) are in body coordinates (N, 3) [m]; NaN where nobody can tell.

    A box with a distance is that far from the body's origin, on the ray through its center. Of any other the middle of
    the lower edge is taken to touch the ground, the plane z = `ground_m` of the body (see `ground_height`): what ends
    above the horizon is nowhere.
    """
    places = np.full((len(boxes), 3), np.nan)
    left, top, right, bottom = boxes.xyxy_px.T
    away = np.full(len(boxes), np.nan) if boxes.distance_m is None else boxes.distance_m
    for name in sorted({str(name) for name in boxes.camera.tolist()} & set(rig.cameras)):
        if not_projectable(rig.cameras[name]) is not None:
            continue
        rows, body_T_camera = np.flatnonzero(boxes.camera == name), rig.body_T_sensor(name)
        origin = body_T_camera[:3, 3]

        def point(v: Float64, rows: Int64 = rows, name: str = name, turn: Float64 = body_T_camera[:3, :3]) -> Float64:
            u = (left[rows] + right[rows]) / 2
            return np.asarray((rays(rig.cameras[name], np.column_stack([u, v]))[:, None, :] * turn).sum(axis=2))

        with np.errstate(invalid="ignore", divide="ignore"):
            middle, low = point((top[rows] + bottom[rows]) / 2), point(bottom[rows])
            along = (middle * origin).sum(axis=1)  # |origin + t middle| = away
            reach = np.sqrt(along**2 - (origin**2).sum() + away[rows] ** 2) - along
            touch = (ground_m - origin[2]) / low[:, 2]
            by_distance = (reach >= 0)[:, None]
            own = np.where(by_distance, reach[:, None] * middle, np.where(touch > 0, touch, np.nan)[:, None] * low)
        places[rows] = origin + own
    return places


def place_truth(run: Run, frame: Int64, boxes: Boxes2D, places: Float64) -> Float64:
    """Return the places (N, 3) of truth boxes in images: the center of the box in space with the same frame, by index,
    and id, where the log has that; else `places`.
    """
    table = run.truth_table("3d")
    if not isinstance(table.boxes, Boxes3D):
        return places
    centers = dict(
        zip(zip(table.frames.tolist(), _ids(table.boxes).tolist(), strict=True), table.boxes.center_m, strict=True)
    )
    found = [centers.get(key) for key in zip(frame.tolist(), _ids(boxes).tolist(), strict=True)]
    known = np.array([at is not None for at in found], bool) & (_ids(boxes) >= 0)
    places = places.copy()
    places[known] = [at for at, is_known in zip(found, known, strict=True) if is_known] or np.zeros((0, 3))
    return places
