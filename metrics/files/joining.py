"""Truth and results of one sequence on the same steps; images of several cameras."""

from dataclasses import dataclass, replace

import numpy as np

from fbench.metrics.core.sequence import Objects, Sequence, Space, Steps
from fbench.metrics.files.side import Doubt, Side, has_solids, unreal
from fbench.replay.contracts.errors import ConfigError, LogError, MetricError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Float64, Int64, Text
from fbench.replay.truth.labelling import TOLERANCE_NS


def by_camera(steps: Steps, truth: Side, estimates: Side, where: tuple[str, str]) -> tuple[Steps, Objects, Objects]:
    """Return steps and the objects of both sides, parted by camera where there are several and boxes are in images.

    Where both sides have solids, these are what is scored, and cameras don't matter: rectangles are left out.

    Raises:
        LogError: where the camera of a rectangle isn't told, though there are several.
    """
    cameras = _names(truth, estimates)
    if len(cameras) < 2:
        return steps, truth.objects, estimates.objects
    if has_solids(truth.objects) and has_solids(estimates.objects):
        return steps, replace(truth.objects, xyxy_px=None), replace(estimates.objects, xyxy_px=None)
    num = len(cameras)
    parted = Steps(
        np.repeat(steps.frame, num),
        np.repeat(steps.stamp_ns, num),
        np.tile(np.arange(num), len(steps)),
        tuple(cameras.tolist()) * len(steps),
    )
    return parted, _parted(truth, cameras, where[0]), _parted(estimates, cameras, where[1])


def _names(*sides: Side) -> Text:
    found: Text = np.unique(np.concatenate([side.camera for side in sides]))
    named: Text = found[found != ""]
    return named


def _parted(side: Side, cameras: Text, where: str) -> Objects:
    if not len(side.objects):
        return side.objects
    there_are = f"there are the cameras {', '.join(cameras.tolist())}; tell that of every box in a column 'camera'"
    if not len(side.camera) or side.objects.xyxy_px is None:
        raise LogError(f"{where}: {there_are}")
    there = np.flatnonzero(~np.isnan(side.objects.xyxy_px).all(axis=1))
    if (side.camera[there] == "").any():
        raise LogError(f"{where}: a box without camera, though {there_are}")
    objects, number = side.objects[there], np.searchsorted(cameras, side.camera[there])
    step: Int64 = objects.step * len(cameras) + number
    order = np.argsort(step, kind="stable")
    return replace(objects[order], step=step[order])


@dataclass(frozen=True)
class Where:
    """Names for errors."""

    sequence: str
    truth: str
    estimates: str


def joined(
    truth: Side, estimates: Side, num_frames: int | None, where: Where, faults: FaultLog, space: Space = "both"
) -> Sequence:
    """Return one sequence of both sides.

    Args:
        truth: All of it; what isn't finite or has no size is left out, and counted as GT004.
        estimates: All of them; what isn't finite stays, and is counted as PRD001.
        num_frames: As told from outside; else as the sides say, else up to the last box of either.
        where: For errors.
        faults: Gets the counts.
        space: Where boxes are compared, see `unreal`.

    Raises:
        ConfigError: where frames, or coordinates, are of different kinds.
        MetricError: where a box is beyond the end, or one id twice in a frame for one class (GT003).
    """
    _require_alike(truth, estimates, where)
    frames = _frames(truth, estimates, num_frames, where)
    own, num_strange = _on_frames(estimates, frames)
    true = _on_frames(truth, frames)[0]
    true, num_invalid = _real(true, where, faults, space)
    num = int(unreal(own.objects, space).sum())
    if num:
        faults.add("PRD001", f"{where.estimates}, sequence {where.sequence}: {num}", num)
    true, own = _same_pixels(true, own)
    steps = _steps(frames, truth)
    steps, in_truth, in_estimates = by_camera(steps, true, own, (where.truth, where.estimates))
    for side, objects in (("truth", in_truth), ("detections", in_estimates)):
        _require_unique(steps, objects, where, side)
    ego = _ego(truth, estimates, frames)
    return Sequence(
        where.sequence,
        steps,
        in_truth,
        in_estimates,
        num_unlabelled=num_strange,
        num_invalid_truth=num_invalid,
        ego_m=None
        if ego is None
        else ego[np.searchsorted(frames, steps.stamp_ns if truth.has_stamps else steps.frame)],
    )


def _require_alike(truth: Side, estimates: Side, where: Where) -> None:
    if len(estimates.objects) and truth.has_stamps != estimates.has_stamps:
        one, other = ("stamps", "frames") if truth.has_stamps else ("frames", "stamps")
        raise ConfigError(f"{where.truth} has {one}, {where.estimates} has {other}; give both the same")
    if truth.space and estimates.space and truth.space != estimates.space:
        raise ConfigError(
            f"{where.truth}: boxes in '{truth.space}', those of {where.estimates} in '{estimates.space}'; "
            "give both the same coordinate frame"
        )


def _frames(truth: Side, estimates: Side, num_frames: int | None, where: Where) -> Int64:
    """Keys of all frames that are scored, ascending."""
    if truth.keys is not None:
        return truth.keys
    if truth.has_stamps:
        return np.unique(truth.objects.step)
    told = next((num for num in (num_frames, truth.num_frames, estimates.num_frames) if num), None)
    last = max((int(side.objects.step[-1]) for side in (truth, estimates) if len(side.objects)), default=-1)
    known = max((int(side.keys[-1]) for side in (estimates,) if side.keys is not None and len(side.keys)), default=-1)
    if told is not None and last >= told:
        side = where.truth if len(truth.objects) and int(truth.objects.step[-1]) >= told else where.estimates
        raise MetricError(f"{side}: sequence {where.sequence} has {told} frames, but a box is in frame {last}")
    return np.arange(max(last, known) + 1 if told is None else told, dtype=np.int64)


def _on_frames(side: Side, frames: Int64) -> tuple[Side, int]:
    """Give steps their numbers; boxes of other frames are left out, and these frames counted."""
    objects = side.objects
    at = _nearest(objects.step, frames, TOLERANCE_NS if side.has_stamps else 0)
    num_strange = len(np.unique(objects.step[at < 0]))
    there = at >= 0
    camera = side.camera[there] if len(side.camera) else side.camera
    return replace(side, objects=replace(objects[there], step=at[there]), camera=camera), num_strange


def _nearest(keys: Int64, frames: Int64, tolerance: int) -> Int64:
    """Number of the frame (N,) that each key belongs to, -1 where it is none."""
    if not len(frames):
        return np.full(len(keys), -1, np.int64)
    right = np.clip(np.searchsorted(frames, keys), 0, len(frames) - 1)
    left = np.maximum(right - 1, 0)
    at = np.where(np.abs(keys - frames[left]) < np.abs(frames[right] - keys), left, right)
    return np.where(np.abs(keys - frames[at]) <= tolerance, at, -1).astype(np.int64)


def without_entry(truth: Side, estimates: Side, sequence: str) -> Doubt:
    """Say which frames of the truth the results don't list, though they list those without boxes too."""
    what = "frame that the results have no entry for, so that all of its truth is missed"
    if truth.keys is None or estimates.keys is None or not estimates.lists_frames:
        return Doubt(what, 0, "")
    at = _nearest(truth.keys, estimates.keys, TOLERANCE_NS if truth.has_stamps else 0)
    missing = truth.keys[at < 0]
    return Doubt(what, len(missing), f"sequence {sequence}, {missing[0]}" if len(missing) else "")


def _real(truth: Side, where: Where, faults: FaultLog, space: Space) -> tuple[Side, int]:
    bad = unreal(truth.objects, space)
    labels, counts = np.unique(truth.objects.label[bad], return_counts=True)
    for label, num in zip(labels.tolist(), counts.tolist(), strict=True):
        faults.add("GT004", f"{where.truth}, sequence {where.sequence}: {num} of class '{label}'", num)
    if not bad.any():
        return truth, 0
    camera = truth.camera[~bad] if len(truth.camera) else truth.camera
    return replace(truth, objects=truth.objects[~bad], camera=camera), int(bad.sum())


def _same_pixels(truth: Side, estimates: Side) -> tuple[Side, Side]:
    """Where both count pixels alike, positions stay as the files have them, bit for bit."""
    if truth.first_pixel == estimates.first_pixel:
        return truth, estimates
    return _from_0(truth), _from_0(estimates)


def _from_0(side: Side) -> Side:
    if not side.first_pixel or side.objects.xyxy_px is None:
        return side
    return replace(side, objects=replace(side.objects, xyxy_px=side.objects.xyxy_px - side.first_pixel))


def _steps(frames: Int64, truth: Side) -> Steps:
    zeros = np.zeros(len(frames), np.int64)
    if truth.has_stamps:
        return Steps(np.arange(len(frames)), frames, zeros)
    return Steps(frames, zeros, zeros)


def _require_unique(steps: Steps, objects: Objects, where: Where, side: str) -> None:
    """Each class may have ids of its own, as where a tracker runs for each (KITTI); profiles look on by themselves."""
    named = objects.track_id >= 0
    step, ids = objects.step[named], objects.track_id[named]
    kind = np.unique(objects.label[named], return_inverse=True)[1]
    order = np.lexsort((kind, ids, step))
    alike = [np.diff(column[order]) == 0 for column in (step, ids, kind)]
    twice = np.flatnonzero(np.all(alike, axis=0))
    if len(twice):
        at = order[twice[0]]
        file = where.truth if side == "truth" else where.estimates
        frame = int(steps.frame[step[at]])
        which = f"{file}, sequence {where.sequence}: id {ids[at]} twice in frame {frame}"
        raise MetricError(f"{which}; an id names one object of a frame", "GT003")


def _ego(truth: Side, estimates: Side, frames: Int64) -> Float64 | None:
    """(frames, 3) where the body is, as the truth says, else as the results do; NaN where nobody says."""
    found = np.full((len(frames), 3), np.nan)
    for side in (estimates, truth):
        if side.ego_m is not None and side.keys is not None:
            at = _nearest(side.keys, frames, TOLERANCE_NS if side.has_stamps else 0)
            told = (at >= 0) & ~np.isnan(side.ego_m).any(axis=1)
            found[at[told]] = side.ego_m[told]
    return None if np.isnan(found).all() else found
