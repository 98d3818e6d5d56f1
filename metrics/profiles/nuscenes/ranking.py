"""Precision and errors over recall, from results with their scores and hits."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.profiles.nuscenes.boxes import LeftOut, distances_m, solids
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
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
    error: Float64  # (K, E) of the K results that hit at the distance for errors, in their order
    has_error: Bool  # (M,) which ones these are


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
    error: Float64  # (M, E) NaN for what hit nothing


def class_rankings(rankings: tuple[Ranking, ...], num_classes: int) -> list[ClassRanking]:
    """Merge the rankings of all sequences, by score, then sequence name, frame and content."""
    parts = sorted(rankings, key=lambda part: part.sequence)
    names = {name: i for i, name in enumerate(dict.fromkeys(part.sequence for part in parts))}
    sequence = np.concatenate([np.full(len(part.score), names[part.sequence]) for part in parts])
    frame, place, kind, score, hit = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("frame", "place", "kind", "score", "hit")
    )
    error = np.full((len(score), parts[0].error.shape[1]), np.nan)
    error[np.concatenate([part.has_error for part in parts])] = np.concatenate([part.error for part in parts])
    num_truth = np.sum([part.num_truth for part in parts], axis=0)
    order = np.lexsort((place, frame, sequence, np.where(np.isnan(score), -np.inf, -score), kind))
    ends = np.searchsorted(kind[order], np.arange(num_classes + 1))
    found = []
    for c in range(num_classes):
        own = order[ends[c] : ends[c + 1]]
        known = score[own][~np.isnan(score[own])]
        best = np.where(np.isnan(score[own]), known[0] if len(known) else 0.0, score[own])
        found.append(ClassRanking(int(num_truth[c]), best, hit[own], error[own]))
    return found


NUM_RECALLS = 101  # Precision is read at recalls 0, 0.01 ... 1.


@dataclass(frozen=True, eq=False)
class Curve:
    """Precision and score (101,) at each recall; both 0 beyond the recall that is achieved."""

    precision: Float64
    confidence: Float64


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
    kept = np.maximum(precision[round((NUM_RECALLS - 1) * min_recall) + 1 :] - min_precision, 0.0)
    return float(np.mean(kept)) / (1.0 - min_precision)


def mean_errors(ranking: ClassRanking, hit: Bool, curve: Curve, min_recall: float) -> Float64:
    """Return each error (5,), cumulated over hits by score, averaged over recalls up to the highest achieved.

    Recalls up to `min_recall` are left out; where no higher one is achieved, every error is 1. An error that no hit
    has (NaN) is 1 too.
    """
    first, num = round((NUM_RECALLS - 1) * min_recall) + 1, ranking.error.shape[1]
    last = int(np.flatnonzero(curve.confidence).max(initial=0))  # the highest recall achieved: the score isn't 0
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


ERRORS = ("ate", "ase", "aoe", "ave", "aae")
UNITS = {"ate": "m", "ase": "1", "aoe": "rad", "ave": "m/s", "aae": "1"}
UNDEFINED = {"traffic_cone": ("aoe", "ave", "aae"), "barrier": ("ave", "aae")}
"""nuscenes-devkit 1.2.0, eval/detection/evaluate.py: cones have no orientation, neither moves or has attributes."""
HALF_TURN = ("barrier",)  # Their two ends look alike: orientation counts modulo pi


def match_errors(truth: Objects, estimates: Objects) -> Float64:
    """Errors (K, 5) of K pairs, in the order of `ERRORS`; NaN where a velocity or the attribute of truth is unknown.

    The scale error is 1 - intersection over union of boxes with one center and heading; that of yaw is the smallest
    angle, modulo half a turn where the ends look alike. Source: nuscenes-devkit 1.2.0, eval/common/utils.py.
    """
    true, said = solids(truth), solids(estimates)
    shared = np.minimum(true.size_lwh_m, said.size_lwh_m).prod(axis=1)
    iou = shared / (true.size_lwh_m.prod(axis=1) + said.size_lwh_m.prod(axis=1) - shared)
    period = np.where(np.isin(truth.label, HALF_TURN), np.pi, 2 * np.pi)
    turn = (true.yaw_rad - said.yaw_rad + period / 2) % period - period / 2
    velocity = attribute = np.full(len(truth), np.nan)
    if truth.velocity_mps is not None and estimates.velocity_mps is not None:
        velocity = distances_m(estimates.velocity_mps[:, :2] - truth.velocity_mps[:, :2])
    if truth.attribute is not None:
        own = np.full(len(truth), "") if estimates.attribute is None else estimates.attribute
        attribute = np.where(truth.attribute == "", np.nan, (truth.attribute != own).astype(np.float64))
    place = distances_m(said.center_m[:, :2] - true.center_m[:, :2])
    return np.stack([place, 1 - iou, np.abs(turn), velocity, attribute], axis=1)
