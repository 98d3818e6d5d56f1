"""Rows of truth and results in an order of their own, and which of them can be scored."""

import numpy as np

from fbench.metrics.matching.blocks import pairs_of
from fbench.metrics.matching.lives import content_ranks, life_ranks
from fbench.metrics.matching.similarity import image_overlaps
from fbench.metrics.objects import Objects
from fbench.metrics.profile import Likeness
from fbench.metrics.sequence import Sequence
from fbench.metrics.validity import is_valid
from fbench.replay.arrays import Array, Bool, Float64, Int64
from fbench.replay.errors import MetricError

DONT_CARE = "dontcare"


def labelled(objects: Objects, labels: tuple[str, ...]) -> Bool:
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
    """Check that no id is twice in a step.

    Raises:
        MetricError: naming frame and id (GT003).
    """
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


def known(values: Float64 | None, objects: Objects, default: float) -> Float64:
    """Return a column (N,) with `default` where nobody knows it."""
    if values is None:
        return np.full(len(objects), default)
    return np.where(np.isnan(values), default, values)


def covered_by_regions(results: Objects, truth: Objects, num_steps: int) -> Float64:
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
