"""Sufficient statistics of detection: each result with its score, what it hit and how far off it was."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.nuscenes.counted import LeftOut
from fbench.replay.arrays import Array, Bool, Float64, Int64, freeze_fields


@dataclass(frozen=True, eq=False)
class Ranking:
    """M results of one sequence that count, of all classes."""

    sequence: str
    num_truth: Int64
    """(C,) truth boxes of each class."""
    frame: Int64
    """(M,) of the sequence."""
    place: Int64
    """(M,) among the results of the frame, in the order of their content."""
    kind: Array
    """(M,) int8 index of the class."""
    score: Float64
    """(M,) NaN where it isn't finite."""
    hit: Bool
    """(M, D) at each distance."""
    error: Float64
    """(K, 5) of the K results that hit at the distance for errors, in their order."""
    has_error: Bool
    """(M,) which ones these are."""

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
    score: Float64
    """(M,) finite: a result without a score ranks first, and has the best score of the others."""
    hit: Bool
    """(M, D)"""
    error: Float64
    """(M, 5) NaN for what hit nothing."""


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
    return [
        ClassRanking(int(num_truth[c]), _filled(score[own]), hit[own], error[own]) for c, own in enumerate(rows)
    ]  # fmt: skip


def _spread(part: Ranking) -> Float64:
    error = np.full((len(part.score), part.error.shape[1]), np.nan)
    error[part.has_error] = part.error
    return error


def _filled(score: Float64) -> Float64:
    unknown = np.isnan(score)
    return np.where(unknown, score[~unknown][0] if not unknown.all() else 0.0, score)
