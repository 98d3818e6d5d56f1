"""A run as the files of nuScenes and Argoverse 2 would have it: solids in the world at keyframes, or in the body."""

from dataclasses import replace

import numpy as np

from fbench.metrics.files.side import find_unreal
from fbench.metrics.reference_runs.rows import names_of
from fbench.metrics.runs.columns import Labelled, objects_of
from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.profiles import Family
from fbench.replay.data.arrays import Bool, Float64, Int64, text_array
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.sequences import Objects, Sequence
from fbench.replay.formats.nuscenes import ATTRIBUTES, MAX_BOXES, TOKENS, attributes
from fbench.replay.geometry.transforms import pose_matrices
from fbench.replay.runs.folder import Run
from fbench.replay.runs.tables import BoxTable


def world_sequence(run: Run, table: BoxTable, family: Family, needs_world: bool) -> Sequence:
    """Return truth and results of a run by nuScenes' names: at keyframes, in the world where the log has poses of all
    of them, else in body coordinates, which do where frames are looked at one by one.

    What a submission couldn't hold is left out of results: classes that aren't scored, and of more than 500 boxes those
    with the lowest scores. Velocities that a pipeline doesn't tell count as 0, as there. Raises MetricError where the
    run has no 3D truth (GT001), or no poses and `needs_world`.
    """
    labeled = Labelled.of(run, "3d")
    if TOKENS in run.manifest.log.metadata:  # only keyframes have a number: between them truth may be interpolated
        labeled = replace(labeled, frames=tuple(frame for frame in labeled.frames if frame.frame_number is not None))
    if not labeled.frames:
        what = "truth in 3D" if any(frame.truth_spaces for frame in run.frames) else "truth"
        raise MetricError(f"{run.folder}: no {what}, so there is nothing to score", "GT001")
    row_of = {frame.index: row for row, frame in enumerate(run.frames)}
    found = run.poses[[row_of[frame.index] for frame in labeled.frames]]
    has_poses = bool(np.isfinite(found).all())
    if needs_world and not has_poses:
        why = "its log doesn't tell where the body was, without which tracks can't be scored in the world"
        raise MetricError(f"{run.folder}: {why}")
    poses = pose_matrices(found[:, :3], found[:, 3:]) if has_poses else np.tile(np.eye(4), (len(found), 1, 1))
    truth = in_world(*labeled.rows(run.truth_table("3d")), poses, family, is_truth=True)
    bad = find_unreal(truth)
    return Sequence(
        run.manifest.log.name,
        labeled.steps(),
        truth[~bad],
        _best(in_world(*labeled.rows(table), poses, family, is_truth=False)),
        len(run.frames) - len(labeled.frames),
        int(bad.sum()),
        ego_m=poses[:, :3, 3] if has_poses else None,
    )


def body_sequence(run: Run, table: BoxTable, family: Family) -> Sequence:
    """Return truth and results of a run in body coordinates, by the names of a benchmark that looks all around.

    Results of classes that the benchmark doesn't have are left out, those without a class are not. Raises MetricError
    without 3D truth (GT001).
    """
    labeled = Labelled.of(run, "3d")
    if not labeled.frames:
        what = "truth in 3D" if any(frame.truth_spaces for frame in run.frames) else "truth"
        raise MetricError(f"{run.folder}: no {what}, so there is nothing to score", "GT001")
    sides = []
    for own in (run.truth_table("3d"), table):
        frame, boxes = labeled.rows(own)
        blank = np.full(len(boxes), "")
        sources, labels = (blank if c is None else c for c in (boxes.source_label, boxes.label))
        names = names_of(family, sources, labels, np.zeros(len(boxes), bool))
        # What has no class at all stays, to be counted as such.
        kept = (names != "") | ((labels == "") & (sources == "")) | (own is not table)
        sides.append(objects_of(replace(boxes, label=names)[kept], frame[kept], np.ones(int(kept.sum()), bool)))
    truth, results = sides
    bad = find_unreal(truth)
    name, num_unlabeled = run.manifest.log.name, len(run.frames) - len(labeled.frames)
    return Sequence(name, labeled.steps(), truth[~bad], results, num_unlabeled, int(bad.sum()))


def in_world(frame: Int64, boxes: Boxes2D | Boxes3D, poses: Float64, family: Family, is_truth: bool) -> Objects:
    """Return N boxes in body coordinates with the names of one of nuScenes' benchmarks and attributes, in the world.

    `frame` (N,) is the step of each, `poses` (F, 4, 4) the `world_T_body` of the steps. Results of classes that aren't
    scored are left out, those without a class are not. Raises MetricError where boxes are in images.
    """
    if not isinstance(boxes, Boxes3D):
        raise MetricError("boxes in images can't be scored as nuScenes scores them, in 3D")
    blank = np.full(len(boxes), "")
    sources, labels, given = (
        blank if column is None else column for column in (boxes.source_label, boxes.label, boxes.attribute)
    )
    names = names_of(family, sources, labels, np.zeros(len(boxes), bool))
    unknown = np.full((len(boxes), 3), np.nan)
    velocity = _turn(poses[frame], unknown if boxes.velocity_mps is None else boxes.velocity_mps)
    if is_truth:
        attribute = np.where(np.isin(given, ATTRIBUTES), given, "")
    else:  # also what follows from how fast they are
        attribute = text_array(attributes(boxes, names.tolist(), velocity))
    pitch = np.zeros(len(boxes)) if boxes.pitch_rad is None else boxes.pitch_rad
    with np.errstate(invalid="ignore"):  # the direction of the length
        ahead = [np.cos(boxes.yaw_rad) * np.cos(pitch), np.sin(boxes.yaw_rad) * np.cos(pitch), -np.sin(pitch)]
    x, y, _ = _turn(poses[frame], np.column_stack(ahead)).T
    own = replace(
        boxes,
        center_m=_turn(poses[frame], boxes.center_m) + poses[frame, :3, 3],
        yaw_rad=np.asarray(np.arctan2(y, x), np.float64),  # in the ground plane of the world
        velocity_mps=velocity if is_truth else np.where(np.isnan(velocity), 0.0, velocity),
        label=names,
        attribute=attribute,
    )
    # What has no class at all stays, to be counted as such.
    kept = (names != "") | ((labels == "") & (sources == "")) | is_truth
    return replace(objects_of(own[kept], frame[kept], np.ones(int(kept.sum()), bool)), distance_m=None, inside=None)


def _turn(poses: Float64, vectors: Float64) -> Float64:
    """Turn vectors (N, 3) into the world; what isn't finite stays so. Sums of products don't depend on the BLAS."""
    with np.errstate(invalid="ignore"):
        x, y, z = ((poses[:, axis, :3] * vectors).sum(axis=1) for axis in range(3))
    return np.column_stack([x, y, z])


def _best(results: Objects) -> Objects:
    """At most `MAX_BOXES` of each step, those with the highest scores."""
    if np.bincount(results.step, minlength=1).max(initial=0) <= MAX_BOXES:
        return results
    order = np.lexsort((-results.score, results.step))
    starts = np.searchsorted(results.step, results.step)
    place = np.empty(len(results), np.int64)
    place[order] = np.arange(len(results)) - starts
    kept: Bool = place < MAX_BOXES
    return results[kept]
