"""Rows of truth and results that can be scored, their pairs, and the thresholds that stand for recalls."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.core.ordering import content_ranks, life_ranks
from fbench.metrics.core.problem import is_valid
from fbench.metrics.core.similarity import blocks, image_overlaps, pairs_of
from fbench.replay.contracts.errors import MetricError
from fbench.replay.contracts.profiles import Likeness
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, freeze_fields
from fbench.replay.data.sequences import Objects, Sequence

DONT_CARE = "dontcare"


def has_label(objects: Objects, labels: tuple[str, ...]) -> Bool:
    """Tell which objects (N,) have one of the labels."""
    return np.isin(objects.label, labels)


def by_content(objects: Objects, sequence: Sequence) -> Objects:
    """Sort the objects of each step by geometry, score and label, so that the order of rows decides nothing.

    Of boxes that are the same in all the one whose track began first, or goes on, is first, and so an assignment takes
    it first.
    """
    box = content_ranks(_content(objects))
    life = life_ranks(box, track_numbers(objects, sequence))
    return objects[np.lexsort((life, box))]


def _content(objects: Objects) -> list[Array]:
    """Step, then what tells boxes of a step apart, most important first."""
    solids = (objects.xyxy_px, objects.center_m, objects.size_lwh_m)
    geometry = [column for values in solids if values is not None for column in values.T[::-1]]
    rest = (objects.yaw_rad, objects.score, objects.label, objects.alpha_rad, objects.occlusion, objects.truncation)
    return [objects.step, *geometry, *(column for column in rest if column is not None)]


def unique_ids(objects: Objects, sequence: Sequence, side: str) -> None:
    """Check that no id is twice in a step. Raises MetricError naming frame and id (GT003)."""
    order = np.lexsort((objects.track_id, objects.step))
    step, ids = objects.step[order], objects.track_id[order]
    twice = np.flatnonzero((step[1:] == step[:-1]) & (ids[1:] == ids[:-1]))
    if len(twice):
        frame, track = sequence.steps.frame[step[twice[0]]], ids[twice[0]]
        raise MetricError(f"{sequence.name}: frame {frame}: {side} has id {track} twice", "GT003")


def sound_truth(truth: Objects, likeness: Likeness) -> Bool:
    """Tell which truth boxes (N,) are finite and have a size above 0; the others are faults (GT004)."""
    if not len(truth):
        return np.zeros(0, np.bool_)
    size = truth.size_lwh_m if likeness != "iou2d" else rectangles(truth)[:, 2:] - rectangles(truth)[:, :2]
    good: Bool = is_valid(truth, likeness)
    return good if size is None else good & np.all(size > 0, axis=1)


def sound_results(results: Objects, likeness: Likeness) -> Bool:
    """Tell which results (M,) are boxes with a score; the others are faults and false positives (PRD001)."""
    return is_valid(results, likeness) if len(results) else np.zeros(0, np.bool_)


def outside(objects: Objects) -> Bool:
    """Tell which objects (N,) are to be ignored: outside the region of interest, or said so by their source."""
    outside = np.zeros(len(objects), np.bool_) if objects.inside is None else ~objects.inside
    return outside if objects.ignore is None else outside | objects.ignore


def rectangles(objects: Objects) -> Float64:
    """Return rectangles (N, 4) in the image; NaN where there is none."""
    nowhere = np.full((len(objects), 4), np.nan)
    return nowhere if objects.xyxy_px is None else np.ascontiguousarray(objects.xyxy_px)


def fill_unknown(values: Float64 | None, objects: Objects, default: float) -> Float64:
    """Return a column (N,) with `default` where nobody knows it."""
    if values is None:
        return np.full(len(objects), default)
    return np.where(np.isnan(values), default, values)


def share_in_regions(results: Objects, truth: Objects, num_steps: int) -> Float64:
    """Return which share (M,) of each result's rectangle the "don't care" region that covers most of it covers."""
    covered, regions = np.zeros(len(results)), truth[truth.label == DONT_CARE]
    if results.xyxy_px is not None and regions.xyxy_px is not None:
        starts = regions.starts(num_steps), results.starts(num_steps)
        shares, _ = image_overlaps(regions, results, *starts, np.ones(len(regions), np.bool_))
        np.maximum.at(covered, pairs_of(*starts)[1], shares)  # below 0 where one of the two is no rectangle
    return covered


def track_numbers(objects: Objects, sequence: Sequence) -> Int64:
    """Number the tracks (N,) from 0; an id in two streams is two tracks."""
    pairs = np.column_stack([sequence.steps.stream[objects.step], objects.track_id]).reshape(-1, 2)
    return np.unique(pairs, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


@dataclass(frozen=True, eq=False)
class Pairs:
    """P pairs of N truth rows with M results over S steps; those of row i are `start[i]:start[i + 1]`."""

    truth_start: Int64  # (S + 1,)
    estimate_start: Int64  # (S + 1,)
    start: Int64  # (N + 1,)
    estimate: Int64  # (P,) ascending within a row
    likeness: Float64  # (P,)

    def __post_init__(self) -> None:
        steps, one = ("i8", ("S1",)), ("f8", ("P",))
        freeze_fields(
            self, truth_start=steps, estimate_start=steps, start=("i8", ("N1",)), estimate=("i8", ("P",)), likeness=one
        )


def pairs_within(truth: Objects, estimates: Objects, num_steps: int, likeness: Likeness, least: float) -> Pairs:
    """Return the pairs whose distance, 1 - intersection over union, is at most 1 - `least`.

    That is AB3DMOT's rule, which rounds the difference; the object benchmark's, above `least`, is stricter.
    """
    starts = truth.starts(num_steps), estimates.starts(num_steps)
    similarity, _ = blocks(truth, estimates, *starts, likeness)
    row, column = pairs_of(*starts)
    near: Bool = 1 - similarity <= 1 - least
    row = row[near]
    return Pairs(*starts, np.searchsorted(row, np.arange(len(truth) + 1)), column[near], similarity[near])


def recall_thresholds(scores: Float64, num_truth: int, num_recalls: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the thresholds nearest to recalls 0, 1/`num_recalls`, 2/`num_recalls` ..., falling, and these recalls.

    Recalls beyond what the hits reach have no threshold; the lowest score always has one.

    Args:
        scores: (H,) of the hits.
        num_truth: Truth boxes, found or missed.
        num_recalls: 40.
    """
    thresholds, recalls, aim = [], [], 0.0
    for i, score in enumerate(np.sort(scores)[::-1].tolist()):
        here, is_last = (i + 1) / num_truth, i == len(scores) - 1
        if not is_last and (i + 2) / num_truth - aim < aim - here:
            continue
        thresholds.append(score)
        recalls.append(aim)
        aim += 1 / num_recalls
    return tuple(thresholds), tuple(recalls)
