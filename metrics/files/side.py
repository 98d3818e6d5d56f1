"""One side, truth or results, of one sequence as its files hold it, and both sides on the same steps."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fbench.replay.contracts.errors import ConfigError, LogError, MetricError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, Text
from fbench.replay.data.sequences import Objects, Sequence, Space, Steps, are_finite
from fbench.replay.truth.labelling import TOLERANCE_NS


@dataclass(frozen=True)
class InputWarning:
    """One kind of oddity in one sequence."""

    what: str  # Of one: `box without a velocity`
    num: int
    where: str = ""  # The first of them; empty where that says nothing


@dataclass
class InputWarnings:
    """Those of all sequences, by their kind."""

    found: dict[str, InputWarning] = field(default_factory=dict)

    def add(self, *warnings: InputWarning) -> None:
        """Count some."""
        for warning in warnings:
            if warning.num:
                known = self.found.get(warning.what)
                self.found[warning.what] = replace(known, num=known.num + warning.num) if known else warning

    def lines(self) -> list[str]:
        """Return a line a kind, with the first place."""
        return [
            f"{w.num} x {w.what}" + (f": {w.where}{' ...' if w.num > 1 else ''}" if w.where else "")
            for w in self.found.values()
        ]


@dataclass(frozen=True, eq=False)
class Side:
    """N boxes with what says when and where they were."""

    objects: Objects  # Their `step` is the key: number of the frame from 0, or stamp [ns]
    keys: Int64 | None = None  # Ascending, of all frames that are known, also empty ones; `None`: 0 to the highest
    has_stamps: bool = False  # Whether keys are stamps
    num_frames: int | None = None  # Where the source says it
    camera: Text = field(default_factory=lambda: np.array([], np.str_))  # (N,) of each rectangle; (0,): nobody says
    space: str = ""  # Coordinate frame of solids; empty: nobody says
    first_pixel: int = 0  # Position of the middle of the first pixel: MOTChallenge counts from 1
    ego_m: Float64 | None = None  # (keys, 3) where the body is, NaN where nobody says
    are_ordered: bool = True  # Whether keys follow time; tokens without a table of samples don't
    lists_frames: bool = False  # Whether frames without boxes have an entry, as in submissions, folders of images
    warnings: tuple[InputWarning, ...] = ()  # What is odd about these boxes, as results

    def select(self, rows: Bool) -> "Side":
        """Return the marked boxes (N,)."""
        return replace(self, objects=self.objects[rows], camera=self.camera[rows] if len(self.camera) else self.camera)


class Where(NamedTuple):
    """Names for errors."""

    sequence: str
    truth: Path
    estimates: Path


def objects_of(columns: dict[str, Any]) -> tuple[Objects, Int64]:
    """Return objects in the order of their steps, those of one step as they came, and the order (N,) in which they are.
    Columns are fields of `Objects`, unsorted; `None` and absent ones are unknown.
    """
    if not len(columns["step"]):
        return nothing(), np.zeros(0, np.int64)
    order = np.argsort(columns["step"], kind="stable")
    if (np.diff(columns["step"]) < 0).any():
        columns = {name: None if value is None else value[order] for name, value in columns.items()}
    return Objects(**columns), order


def nothing() -> Objects:
    """Return no objects, of both kinds."""
    none, triple, ids = np.zeros(0), np.zeros((0, 3)), np.zeros(0, np.int64)
    return Objects(ids, np.zeros(0, "U1"), ids, none, np.zeros((0, 4)), triple, triple, none)


def find_unreal(objects: Objects, space: Space = "both") -> Bool:
    """Tell which boxes (N,) aren't finite, or have no size; also those that are neither in an image nor in space. A
    rectangle without size is no matter where boxes are compared in space (`3d`), nor a solid without size in images
    (`2d`). Nothing may be infinite anywhere.
    """
    bad, anywhere = ~np.isfinite(objects.score), np.zeros(len(objects), bool)
    if objects.xyxy_px is not None:
        there, finite = _there(objects.xyxy_px), are_finite(objects.xyxy_px)
        xyxy = np.where(finite[:, None], objects.xyxy_px, 0.0)
        bad |= there & ~(finite & ((space == "3d") | (xyxy[:, 2:] - xyxy[:, :2] > 0).all(axis=1)))
        anywhere |= there
    if objects.center_m is not None and objects.size_lwh_m is not None and objects.yaw_rad is not None:
        numbers = np.column_stack([objects.center_m, objects.size_lwh_m, objects.yaw_rad])
        there = _there(numbers)
        bad |= there & ~(are_finite(numbers) & ((space == "2d") | (objects.size_lwh_m > 0).all(axis=1)))
        anywhere |= there
    return np.asarray(bad | ~anywhere)


def has_solids(objects: Objects) -> bool:
    """Tell whether any box has one, or there are no boxes at all."""
    return objects.center_m is not None and (not len(objects) or bool(_there(objects.center_m).any()))


def _there(numbers: Array) -> Bool:
    return ~np.asarray(np.isnan(numbers).all(axis=1))


def join(
    truth: Side, estimates: Side, num_frames: int | None, where: Where, faults: FaultLog, space: Space = "both"
) -> Sequence:
    """Return one sequence of both sides, compared in `space`, see `find_unreal`. It has `num_frames`; else as many as
    the sides say, else up to the last box of either. Truth that isn't finite or has no size is left out, and counted as
    GT004; such estimates stay, and are counted as PRD001. Raises ConfigError where frames, or coordinates, are of
    different kinds, MetricError where a box is beyond the end, or one id twice in a frame for one class (GT003).
    """
    if len(estimates.objects) and truth.has_stamps != estimates.has_stamps:
        one, other = ("stamps", "frames") if truth.has_stamps else ("frames", "stamps")
        raise ConfigError(f"{where.truth} has {one}, {where.estimates} has {other}; give both the same")
    if truth.space and estimates.space and truth.space != estimates.space:
        spaces = f"{where.truth}: boxes in '{truth.space}', those of {where.estimates} in '{estimates.space}'"
        raise ConfigError(f"{spaces}; give both the same coordinate frame")
    frames = _frames(truth, estimates, num_frames, where)
    own, num_strange = _place_on_frames(estimates, frames)
    true, _ = _place_on_frames(truth, frames)

    bad = find_unreal(true.objects, space)
    labels, counts = np.unique(true.objects.label[bad], return_counts=True)
    for label, num in zip(labels.tolist(), counts.tolist(), strict=True):
        faults.add("GT004", f"{where.truth}, sequence {where.sequence}: {num} of class '{label}'", num)
    true = true.select(~bad) if bad.any() else true
    if num := int(find_unreal(own.objects, space).sum()):
        faults.add("PRD001", f"{where.estimates}, sequence {where.sequence}: {num}", num)

    if true.first_pixel != own.first_pixel:  # where both count alike, positions stay as the files have them
        true, own = _count_from_pixel_0(true), _count_from_pixel_0(own)
    zeros = np.zeros(len(frames), np.int64)
    steps = Steps(np.arange(len(frames)), frames, zeros) if truth.has_stamps else Steps(frames, zeros, zeros)
    steps, in_truth, in_estimates = _split_by_camera(steps, true, own, where)
    for file, objects in ((where.truth, in_truth), (where.estimates, in_estimates)):
        _require_unique(steps, objects, f"{file}, sequence {where.sequence}")
    ego = _ego(truth, estimates, frames)
    keys = steps.stamp_ns if truth.has_stamps else steps.frame
    return Sequence(
        where.sequence, steps, in_truth, in_estimates, num_strange, int(bad.sum()),
        ego_m=None if ego is None else ego[np.searchsorted(frames, keys)],
    )  # fmt: skip


def _count_from_pixel_0(side: Side) -> Side:
    if not side.first_pixel or side.objects.xyxy_px is None:
        return side
    return replace(side, objects=replace(side.objects, xyxy_px=side.objects.xyxy_px - side.first_pixel))


def _frames(truth: Side, estimates: Side, num_frames: int | None, where: Where) -> Int64:
    """Keys of all frames that are scored, ascending."""
    if truth.keys is not None:
        return truth.keys
    if truth.has_stamps:
        return np.unique(truth.objects.step)
    given = num_frames or truth.num_frames or estimates.num_frames
    lasts = [int(side.objects.step[-1]) if len(side.objects) else -1 for side in (truth, estimates)]
    if not given:
        known = -1 if estimates.keys is None else int(estimates.keys.max(initial=-1))
        return np.arange(max(*lasts, known) + 1)
    if max(lasts) >= given:
        side = where.truth if lasts[0] >= given else where.estimates
        raise MetricError(f"{side}: sequence {where.sequence} has {given} frames, but a box is in frame {max(lasts)}")
    return np.arange(given)


def _place_on_frames(side: Side, frames: Int64) -> tuple[Side, int]:
    """Give steps their numbers; boxes of other frames are left out, and these frames counted."""
    step = side.objects.step
    at = _nearest(step, frames, TOLERANCE_NS if side.has_stamps else 0)
    there = at >= 0
    kept = side if there.all() else side.select(there)
    return replace(kept, objects=replace(kept.objects, step=at[there])), len(np.unique(step[~there]))


def _nearest(keys: Int64, frames: Int64, tolerance: int) -> Int64:
    """Number of the frame (N,) that each key belongs to, -1 where it is none."""
    if not len(frames):
        return np.full(len(keys), -1, np.int64)
    right = np.clip(np.searchsorted(frames, keys), 0, len(frames) - 1)
    left = np.maximum(right - 1, 0)
    at = np.where(np.abs(keys - frames[left]) < np.abs(frames[right] - keys), left, right)
    return np.where(np.abs(keys - frames[at]) <= tolerance, at, -1).astype(np.int64)


def find_missing_entries(truth: Side, estimates: Side, sequence: str) -> InputWarning:
    """Say which frames of the truth the results don't list, though they list those without boxes too."""
    what = "frame that the results have no entry for, so that all of its truth is missed"
    if truth.keys is None or estimates.keys is None or not estimates.lists_frames:
        return InputWarning(what, 0)
    at = _nearest(truth.keys, estimates.keys, TOLERANCE_NS if truth.has_stamps else 0)
    missing = truth.keys[at < 0]
    return InputWarning(what, len(missing), f"sequence {sequence}, {missing[0]}" if len(missing) else "")


def _split_by_camera(steps: Steps, truth: Side, estimates: Side, where: Where) -> tuple[Steps, Objects, Objects]:
    """Steps and objects by camera where there are several and boxes are in images. Where both sides have solids, these
    are what is scored, and cameras don't matter: rectangles are left out.
    """
    cameras: Text = np.unique(np.concatenate([truth.camera, estimates.camera]))
    cameras = cameras[cameras != ""]
    if len(cameras) < 2:
        return steps, truth.objects, estimates.objects
    if has_solids(truth.objects) and has_solids(estimates.objects):
        return steps, replace(truth.objects, xyxy_px=None), replace(estimates.objects, xyxy_px=None)
    num, num_steps, objects = len(cameras), len(steps), []
    there_are = f"there are the cameras {', '.join(cameras.tolist())}; tell that of every box in a column 'camera'"
    for side, file in ((truth, where.truth), (estimates, where.estimates)):
        if not len(side.objects):
            objects.append(side.objects)
            continue
        if not len(side.camera) or side.objects.xyxy_px is None:
            raise LogError(f"{file}: {there_are}")
        flat = side.select(_there(side.objects.xyxy_px))
        if (flat.camera == "").any():
            raise LogError(f"{file}: a box without camera, though {there_are}")
        step = flat.objects.step * num + np.searchsorted(cameras, flat.camera)
        order = np.argsort(step, kind="stable")
        objects.append(replace(flat.objects[order], step=step[order]))
    frame, stamp_ns, stream = np.repeat(steps.frame, num), np.repeat(steps.stamp_ns, num), np.arange(num)
    split = Steps(frame, stamp_ns, np.tile(stream, num_steps), tuple(cameras.tolist()) * num_steps)
    return split, objects[0], objects[1]


def _require_unique(steps: Steps, objects: Objects, where: str) -> None:
    """Each class may have ids of its own, as where a tracker runs for each (KITTI); profiles check on their own."""
    named = objects.track_id >= 0
    step, ids = objects.step[named], objects.track_id[named]
    kind = np.unique(objects.label[named], return_inverse=True)[1]
    order = np.lexsort((kind, ids, step))
    twice = np.flatnonzero(np.all([np.diff(column[order]) == 0 for column in (step, ids, kind)], axis=0))
    if len(twice):
        at = order[twice[0]]
        which = f"{where}: id {ids[at]} twice in frame {int(steps.frame[step[at]])}"
        raise MetricError(f"{which}; an id names one object of a frame", "GT003")


def _ego(truth: Side, estimates: Side, frames: Int64) -> Float64 | None:
    """(frames, 3) where the body is, as the truth says, else as the results do; NaN where nobody says."""
    found = np.full((len(frames), 3), np.nan)
    for side in (estimates, truth):
        if side.ego_m is not None and side.keys is not None:
            at = _nearest(side.keys, frames, TOLERANCE_NS if side.has_stamps else 0)
            known = (at >= 0) & ~np.isnan(side.ego_m).any(axis=1)
            found[at[known]] = side.ego_m[known]
    return None if np.isnan(found).all() else found
