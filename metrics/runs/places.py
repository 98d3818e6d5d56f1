"""Places of boxes in the world, and which truth boxes some sensor sees."""

from collections.abc import Callable, Hashable, Sequence
from functools import cached_property
from typing import TypeVar, cast

import numpy as np

from fbench.metrics.runs.columns import Labelled
from fbench.replay.contracts.errors import ConfigError, did_you_mean
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.metadata import Region, inside
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.geometry.transforms import pose_matrices
from fbench.replay.runs.folder import Run

T = TypeVar("T")


class SharedRun(Run):
    """A run that keeps what is derived of it for as long as it lives; metrics that don't know of it see a run."""

    @cached_property
    def kept(self) -> dict[Hashable, object]:
        """By what it is and all that it depends on."""
        return {}


def once(run: Run, key: Hashable, make: Callable[[], T]) -> T:
    """Return what `make` returns; of a shared run it is called for the first time only."""
    if not isinstance(run, SharedRun):
        return make()
    if key not in run.kept:
        run.kept[key] = make()
    return cast(T, run.kept[key])


SHOWN_FROM = 0.4
"""Visible share from which on a camera shows a box where truth in images doesn't tell: nuScenes' lowest bin, which ends
there, also holds what shows nothing.
"""
_UNSEEN, _UNTOLD, _SEEN = 0, 1, 2  # What a kind of sensor tells of a box; of several kinds the highest counts


def seen_by_some(labelled: Labelled, frame: Int64, truth: Boxes3D, options: ScoreOptions) -> Bool | None:
    """Tell which truth boxes (N,) at least one sensor of the log sees, whatever the pipeline got; `None` where truth
    doesn't tell.

    A LiDAR or radar sees what it has a point on, or as many as the options ask for. A camera sees what truth in its
    images shows and doesn't ignore; where no image has truth, that of which at least `SHOWN_FROM` is visible. A box
    counts as seen unless every kind of sensor that the rig has tells that it doesn't see it.

    Args:
        labelled: The run's frames with 3D truth.
        frame: (N,) which of these frames each box belongs to.
        truth: The boxes.
        options: How many points it takes.
    """
    num = max(options.seen, 1)
    answers = {
        "camera": _in_images(labelled, frame, truth),
        "lidar": _by_points(truth.num_lidar_pts, len(truth), num),
        "radar": _by_points(truth.num_radar_pts, len(truth), num),
    }
    found, is_told = np.full(len(truth), _UNTOLD, np.int8), True
    for rig, rows in labelled.rigs(frame):
        kinds = {mount.kind for mount in rig.mounts.values()}
        own = [answer for kind, answer in answers.items() if kind in kinds]
        found[rows] = np.max([answer[rows] for answer in own], axis=0, initial=_UNTOLD if not own else _UNSEEN)
        is_told &= bool(own) and all((answer != _UNTOLD).any() for answer in own)
    return None if not is_told and (found != _SEEN).any() else found > _UNSEEN


def require_told(labelled: Labelled, seen: Bool | None, options: ScoreOptions) -> None:
    """Refuse to score only what is seen where nobody tells. Raises ConfigError naming the log."""
    if options.seen and seen is None:
        raise ConfigError(
            f"log '{labelled.run.manifest.log.name}': its truth doesn't tell of each kind of sensor what that sees "
            "(num_lidar_pts, num_radar_pts, and boxes in images or visibility); score without --seen"
        )


def only_seen(options: ScoreOptions) -> str:
    """Say that scores are restricted to what is seen."""
    if options.seen > 1:
        return f", seen with {options.seen} points"
    return ", seen" if options.seen else ""


def _by_points(points: Int64 | None, num_boxes: int, at_least: int) -> Array:
    """What a kind of sensor tells of each box (N,)."""
    if points is None:
        return np.full(num_boxes, _UNTOLD, np.int8)
    return np.select([points >= at_least, points >= 0], [_SEEN, _UNSEEN], _UNTOLD).astype(np.int8)


def _in_images(labelled: Labelled, frame: Int64, truth: Boxes3D) -> Array:
    """What cameras tell of each box (N,)."""
    run = labelled.run
    with_images = [record.index for record in run.frames if "2d" in record.truth_spaces.split()]
    if not with_images:
        share = np.full(len(truth), np.nan) if truth.visibility is None else truth.visibility
        return np.select([share >= SHOWN_FROM, share < SHOWN_FROM], [_SEEN, _UNSEEN], _UNTOLD).astype(np.int8)
    at, ids = labelled.indices[frame], _ids(truth.track_id, len(truth))
    table = run.truth_table("2d")
    flat_ids = _ids(table.boxes.track_id, len(table.boxes))
    shown = flat_ids >= 0 if table.boxes.ignore is None else (flat_ids >= 0) & ~table.boxes.ignore
    found = _held((at, ids), (table.frames[shown], flat_ids[shown]))
    told = np.isin(at, with_images) & (ids >= 0)
    return np.select([found, told], [_SEEN, _UNSEEN], _UNTOLD).astype(np.int8)


def _ids(track_id: Int64 | None, num: int) -> Int64:
    return np.full(num, -1, np.int64) if track_id is None else track_id


def _held(keys: tuple[Int64, Int64], others: tuple[Int64, Int64]) -> Bool:
    """Tell which keys (N,) are among the others."""
    own, rest = np.column_stack(keys), np.column_stack(others)
    number = np.unique(np.concatenate([own, rest]), axis=0, return_inverse=True)[1].reshape(-1)
    return np.isin(number[: len(own)], number[len(own) :])


def has_poses(run: Run) -> bool:
    """Whether all frames of a run have a pose."""
    return bool(np.isfinite(run.poses).all())


def regions_of(run: Run) -> tuple[Region, ...]:
    """The regions of a run's log."""
    return once(run, "regions", lambda: run.manifest.log_info.regions)


def chosen_regions(run: Run, kinds: Sequence[str]) -> tuple[Region, ...]:
    """Return the regions of these kinds. Raises ConfigError where the log has no such kind, or no poses, so that nobody
    knows where boxes are in the world.
    """
    regions = regions_of(run)
    known = list(dict.fromkeys(region.kind for region in regions))
    for kind in kinds:
        if kind not in known:
            raise ConfigError(f"log '{run.manifest.log.name}' has no region '{kind}'{did_you_mean(kind, known)}")
    if not has_poses(run):
        raise ConfigError(f"log '{run.manifest.log.name}' doesn't tell where the body was, so that its regions can't "
                          "be used; score without --region")  # fmt: skip
    return tuple(region for region in regions if region.kind in kinds)


def ground_points(run: Run, frame: Int64, center_m: Float64) -> Float64:
    """Return x, y (N, 2) in the world of points (N, 3) in body coordinates [m] at frames (N,) by index; inf where a
    point isn't finite.
    """
    frames, at = np.unique(frame, return_inverse=True)
    world_T_body = _poses(run, frames)[at]
    x, y = ((world_T_body[:, axis, :3] * center_m).sum(axis=1) + world_T_body[:, axis, 3] for axis in (0, 1))
    return np.asarray(np.nan_to_num(np.column_stack([x, y]), nan=np.inf), np.float64)


def on_ground(run: Run, kinds: Sequence[str], frame: Int64, center_m: Float64) -> Bool:
    """Tell which points (N, 3), as in `ground_points`, lie in a region of these kinds. Raises ConfigError as
    `chosen_regions`.
    """
    regions = chosen_regions(run, kinds)
    return np.asarray(inside(regions, ground_points(run, frame, center_m)), bool)


def _poses(run: Run, frames: Int64) -> Float64:
    """(F, 4, 4) of these frames by index."""
    row_of = {frame.index: row for row, frame in enumerate(run.frames)}
    rows = run.poses[[row_of[index] for index in frames.tolist()]]
    return pose_matrices(rows[:, :3], rows[:, 3:])
