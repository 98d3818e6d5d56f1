"""Rows of truth and results that can be scored, their pairs, and the thresholds that stand for recalls."""

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from fbench.metrics.core.ordering import content_ranks, life_ranks, number_tracks
from fbench.metrics.core.problem import is_valid
from fbench.metrics.core.similarity import blocks, image_overlaps
from fbench.replay.contracts.profiles import SimilarityKind
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.sequences import Objects, Sequence

T = TypeVar("T")
DONT_CARE = "dontcare"


@dataclass(frozen=True)
class KittiClass:
    """A class, and its neighbor that is neither a hit nor a miss; empty: there is none."""

    label: str
    neighbor: str = ""

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels whose boxes are matched."""
        return (self.label, self.neighbor) if self.neighbor else (self.label,)


@dataclass(frozen=True)
class Tables(Generic[T]):
    """Tables of sequences, those of a profile's classes each.

    Thresholds depend on the scores of all sequences, so boxes are kept, about 60 bytes each, and counted at the end.
    """

    tables: tuple[tuple[T, ...], ...]

    def __add__(self, other: "Tables[T]") -> "Tables[T]":
        return Tables(self.tables + other.tables)


def by_content(objects: Objects, sequence: Sequence) -> Objects:
    """Sort the objects of each step by geometry, score and label, so that the order of rows decides nothing.

    Of boxes that are the same in all the one whose track began first, or goes on, is first, and so an assignment takes
    it first.
    """
    o = objects
    geometry = (values.T[::-1] for values in (o.xyxy_px, o.center_m, o.size_lwh_m) if values is not None)
    rest = (o.yaw_rad, o.score, o.label, o.alpha_rad, o.occlusion, o.truncation)
    columns = [*(column for part in geometry for column in part), *(column for column in rest if column is not None)]
    box = content_ranks([o.step, *columns])
    life = life_ranks(box, number_tracks(o.track_id, sequence.steps.stream[o.step]))
    return objects[np.lexsort((life, box))]


def are_sound(objects: Objects, similarity: SimilarityKind, is_truth: bool) -> Bool:
    """Tell which objects (N,) are finite boxes with a score, and which truth has a size above 0. The others are faults:
    GT004 of truth, PRD001 of results, which are false positives then.
    """
    if not len(objects):
        return np.zeros(0, np.bool_)
    good = is_valid(objects, similarity)
    size = objects.size_lwh_m if similarity != "iou2d" else rectangles(objects)[:, 2:] - rectangles(objects)[:, :2]
    return good & np.all(size > 0, axis=1) if is_truth and size is not None else good


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
    return np.full(len(objects), default) if values is None else np.where(np.isnan(values), default, values)


def share_in_regions(results: Objects, truth: Objects, num_steps: int) -> Float64:
    """Return which share (M,) of each result's rectangle the "don't care" region that covers most of it covers."""
    covered, regions = np.zeros(len(results)), truth[truth.label == DONT_CARE]
    if results.xyxy_px is not None and regions.xyxy_px is not None:
        shares = image_overlaps(regions, results, num_steps, np.ones(len(regions), np.bool_))
        place = np.flatnonzero(shares.values > 0)  # below 0 where one of the two is no rectangle
        np.maximum.at(covered, shares.locate(place)[1], shares.values[place])
    return covered


@dataclass(frozen=True, eq=False)
class Pairs:
    """P pairs of N truth rows with M results over S steps; those of row i are `start[i]:start[i + 1]`."""

    truth_start: Int64  # (S + 1,)
    estimate_start: Int64  # (S + 1,)
    start: Int64  # (N + 1,)
    estimate: Int64  # (P,) ascending within a row
    similarity: Float64  # (P,)


def pairs_within(truth: Objects, estimates: Objects, num_steps: int, similarity: SimilarityKind, least: float) -> Pairs:
    """Return the pairs whose distance, 1 - intersection over union, is at most 1 - `least`.

    That is AB3DMOT's rule, which rounds the difference; the object benchmark's, above `least`, is stricter.
    """
    found = blocks(truth, estimates, num_steps, similarity)
    near = np.flatnonzero(1 - found.values <= 1 - least)
    row, column = found.locate(near)
    start = np.searchsorted(row, np.arange(len(truth) + 1))
    return Pairs(found.row_start, found.column_start, start, column, found.values[near])


def recall_thresholds(scores: Float64, num_truth: int, num_recalls: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the thresholds nearest to recalls 0, 1/`num_recalls`, 2/`num_recalls` ..., falling, and these recalls.

    Recalls beyond what the hits reach have no threshold; the lowest score always has one. `scores` (H,) are those of
    the hits, `num_truth` counts truth boxes, found or missed.
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
