"""Precision and errors over recall, from results with their scores and hits."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.profiles.nuscenes.boxes import LeftOut, solids
from fbench.replay.data.arrays import Array, Bool, Float64, Int64, freeze_fields
from fbench.replay.data.sequences import Objects


@dataclass(frozen=True, eq=False)
class Ranking:
    """M results of one sequence that count, of all classes."""

    sequence: str
    num_truth: Int64  # (C,) truth boxes of each class
    frame: Int64  # (M,) of the sequence
    place: Int64  # (M,) among the results of the frame, in the order of their content
    kind: Array  # (M,) int8 index of the class
    score: Float64  # (M,) NaN where it isn't finite
    hit: Bool  # (M, D) at each distance
    error: Float64  # (K, 5) of the K results that hit at the distance for errors, in their order
    has_error: Bool  # (M,) which ones these are

    def __post_init__(self) -> None:
        freeze_fields(
            self, num_truth=("i8", ("C",)), frame=("i8", ("M",)), place=("i8", ("M",)), kind=("i1", ("M",)),
            score=("f8", ("M",)), hit=("?", ("M", "D")), error=("f8", ("K", 5)), has_error=("?", ("M",)),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class DetectionStatistics:
    """Rankings of any number of sequences; their order doesn't matter, because results have a total order."""

    parts: tuple[Ranking, ...]
    left_out: LeftOut

    def __add__(self, other: "DetectionStatistics") -> "DetectionStatistics":
        return DetectionStatistics(self.parts + other.parts, self.left_out + other.left_out)


@dataclass(frozen=True, eq=False)
class ClassRanking:
    """M results of one class over all sequences, the best score first."""

    num_truth: int
    score: Float64  # (M,) finite: a result without a score ranks first, and has the best score of the others
    hit: Bool  # (M, D)
    error: Float64  # (M, 5) NaN for what hit nothing


def class_rankings(statistics: DetectionStatistics, num_classes: int) -> list[ClassRanking]:
    """Merge the rankings of all sequences, by score, then sequence name, frame and content."""
    parts = sorted(statistics.parts, key=lambda part: part.sequence)
    names = {name: i for i, name in enumerate(dict.fromkeys(part.sequence for part in parts))}
    sequence = np.concatenate([np.full(len(part.score), names[part.sequence]) for part in parts])
    frame, place, kind, score, hit = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("frame", "place", "kind", "score", "hit")
    )
    error = np.concatenate([_spread(part) for part in parts])
    num_truth = np.sum([part.num_truth for part in parts], axis=0)
    first = np.where(np.isnan(score), -np.inf, -score)
    order = np.lexsort((place, frame, sequence, first, kind))
    ends = np.searchsorted(kind[order], np.arange(num_classes + 1))
    rows = [order[ends[c] : ends[c + 1]] for c in range(num_classes)]
    return [ClassRanking(int(num_truth[c]), _fill(score[own]), hit[own], error[own]) for c, own in enumerate(rows)]


def _spread(part: Ranking) -> Float64:
    error = np.full((len(part.score), part.error.shape[1]), np.nan)
    error[part.has_error] = part.error
    return error


def _fill(score: Float64) -> Float64:
    unknown = np.isnan(score)
    return np.where(unknown, score[~unknown][0] if not unknown.all() else 0.0, score)


NUM_RECALLS = 101  # Precision is read at recalls 0, 0.01 ... 1.


@dataclass(frozen=True, eq=False)
class Curve:
    """Precision and score (101,) at each recall; both 0 beyond the recall that is achieved."""

    precision: Float64
    confidence: Float64

    @property
    def last(self) -> int:
        """Index of the highest recall achieved: the last score that isn't 0."""
        used = np.flatnonzero(self.confidence)
        return int(used[-1]) if len(used) else 0


def precision_curve(score: Float64, hit: Bool, num_truth: int) -> Curve:
    """Return the curve of results (M,), best score first, at one distance: linear between the recalls of results."""
    if not num_truth or not hit.any():
        return Curve(np.zeros(NUM_RECALLS), np.zeros(NUM_RECALLS))
    tp = np.cumsum(hit)
    recall, precision = tp / num_truth, tp / np.arange(1, len(tp) + 1)
    wanted = np.linspace(0, 1, NUM_RECALLS)
    return Curve(np.interp(wanted, recall, precision, right=0), np.interp(wanted, recall, score, right=0))


def average_precision(precision: Float64, min_recall: float, min_precision: float) -> float:
    """Mean of precision (101,) above `min_recall`, less `min_precision` and floored at 0, as share of its maximum."""
    kept = np.maximum(precision[_first(min_recall) :] - min_precision, 0.0)
    return float(np.mean(kept)) / (1.0 - min_precision)


def mean_errors(ranking: ClassRanking, hit: Bool, curve: Curve, min_recall: float) -> Float64:
    """Return each error (5,), cumulated over hits by score, averaged over recalls up to the highest achieved.

    Recalls up to `min_recall` are left out; where no higher one is achieved, every error is 1. An error that no hit
    has (NaN) is 1 too.
    """
    first, last = _first(min_recall), curve.last
    num = ranking.error.shape[1]
    if last < first or not hit.any():
        return np.ones(num)
    score, errors = ranking.score[hit][::-1], ranking.error[hit]
    wanted = curve.confidence[first : last + 1][::-1]
    means = [np.mean(np.interp(wanted, score, cumulative_mean(errors[:, i])[::-1])[::-1]) for i in range(num)]
    return np.array(means, np.float64)


def cumulative_mean(values: Array) -> Float64:
    """Mean of the values (K,) up to each, without NaN: 0 before the first number, 1 throughout where there is none."""
    known = ~np.isnan(values)
    if not known.any():
        return np.ones(len(values))
    num = np.cumsum(known)
    mean: Float64 = np.cumsum(np.where(known, values, 0.0)) / np.maximum(num, 1)
    return mean


def _first(min_recall: float) -> int:
    return round((NUM_RECALLS - 1) * min_recall) + 1


ERRORS = ("ate", "ase", "aoe", "ave", "aae")
UNITS = {"ate": "m", "ase": "1", "aoe": "rad", "ave": "m/s", "aae": "1"}
UNDEFINED = {"traffic_cone": ("aoe", "ave", "aae"), "barrier": ("ave", "aae")}
"""nuscenes-devkit 1.2.0, eval/detection/evaluate.py: cones have no orientation, neither moves or has attributes."""
HALF_TURN = ("barrier",)  # Their two ends look alike: orientation counts modulo pi


def match_errors(truth: Objects, estimates: Objects) -> Float64:
    """Errors (K, 5) of K pairs, in the order of `ERRORS`; NaN where a velocity or the attribute of truth is unknown.

    Source: nuscenes-devkit 1.2.0, eval/common/utils.py.
    """
    true, said = solids(truth), solids(estimates)
    half_turn = np.isin(truth.label, HALF_TURN)
    errors: Float64 = np.stack(
        [
            _norm(said.center_m[:, :2] - true.center_m[:, :2]),
            1 - _scale_iou(true.size_lwh_m, said.size_lwh_m),
            _yaw_error(true.yaw_rad, said.yaw_rad, np.where(half_turn, np.pi, 2 * np.pi)),
            _velocity_error(truth, estimates),
            _attribute_error(truth, estimates),
        ],
        axis=1,
    )
    return errors


def _norm(xy: Array) -> Float64:
    norm: Float64 = np.sqrt(xy[:, 0] ** 2 + xy[:, 1] ** 2)
    return norm


def _scale_iou(a: Array, b: Array) -> Float64:
    """Intersection over union (K,) of boxes with one center and heading."""
    shared = np.minimum(a, b).prod(axis=1)
    iou: Float64 = shared / (a.prod(axis=1) + b.prod(axis=1) - shared)
    return iou


def _yaw_error(truth: Array, estimates: Array, period: Array) -> Float64:
    """Smallest angle (K,) between headings, modulo `period`."""
    turn = (truth - estimates + period / 2) % period - period / 2
    error: Float64 = np.abs(turn)
    return error


def _velocity_error(truth: Objects, estimates: Objects) -> Float64:
    if truth.velocity_mps is None or estimates.velocity_mps is None:
        return np.full(len(truth), np.nan)
    return _norm(estimates.velocity_mps[:, :2] - truth.velocity_mps[:, :2])


def _attribute_error(truth: Objects, estimates: Objects) -> Float64:
    if truth.attribute is None:
        return np.full(len(truth), np.nan)
    said = np.full(len(truth), "") if estimates.attribute is None else estimates.attribute
    return np.where(truth.attribute == "", np.nan, (truth.attribute != said).astype(np.float64))
