"""Precision, recall and F1 of detections at every score threshold, and deviations of distance and speed."""

from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from fbench.metrics.core.exact import Counts, exact_sum
from fbench.metrics.core.slices import Group, ScoreKey, ground_range
from fbench.metrics.detection import outcomes
from fbench.metrics.detection.horizon import RangeCounts
from fbench.metrics.detection.outcomes import BoxCounts, Outcome
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence


@dataclass(frozen=True)
class Deviation(Counts):
    """Sum of absolute errors of some hits; can be added exactly in any order."""

    total: Fraction = Fraction(0)
    num: int = 0

    @classmethod
    def of(cls, truth: Float64 | None, estimates: Float64 | None) -> "Deviation":
        """Compare K hits, as far as both sides know the quantity."""
        if truth is None or estimates is None:
            return cls()
        error = np.abs(estimates - truth)
        known = error[np.isfinite(error)]
        return cls(exact_sum(known), len(known))


def range_rates(sequence: Sequence) -> Float64 | None:
    """Change of distance [m/s] (N,) of the truth boxes, positive when receding: as truth says, else from the distances
    one step before and one step after on the same track (central difference); NaN where neither is known.
    """
    truth, steps = sequence.truth, sequence.steps
    if truth.range_rate_mps is not None or truth.distance_m is None:
        return truth.range_rate_mps
    rate = np.full(len(truth), np.nan)
    stream, stamp_ns = steps.stream[truth.step], steps.stamp_ns[truth.step]
    place = steps.places[truth.step]
    order = np.lexsort([place, truth.track_id, stream])
    before, here, after = order[:-2], order[1:-1], order[2:]
    near = np.array(
        [
            (truth.track_id[here] >= 0) & (truth.track_id[other] == truth.track_id[here])
            & (stream[other] == stream[here]) & (np.abs(place[other] - place[here]) == 1)
            for other in (before, after)
        ]
    ).all(axis=0)  # fmt: skip
    lapse = (stamp_ns[after] - stamp_ns[before]) * 1e-9  # of whole numbers: floats of this size would round
    good = near & (lapse > 0)
    rate[here[good]] = (truth.distance_m[after] - truth.distance_m[before])[good] / lapse[good]
    return rate


_RECALLS = np.linspace(0, 1, 101)


@dataclass(frozen=True, eq=False)
class Ranking:
    """Counts at each score that occurs, highest first; can be added in any order."""

    scores: Float64  # (U,) all different
    tp: Int64  # (U,) hits of this score
    fp: Int64  # (U,) false alarms of this score
    num_truth: int

    @classmethod
    def of(cls, scores: Float64, hit: Bool, num_truth: int) -> "Ranking":
        """Count K estimates that are a hit or a false alarm."""
        return cls._merge(scores, hit.astype(np.int64), (~hit).astype(np.int64), num_truth)

    def __add__(self, other: "Ranking") -> "Ranking":
        scores, tp, fp = (np.concatenate([getattr(self, n), getattr(other, n)]) for n in ("scores", "tp", "fp"))
        return self._merge(scores, tp, fp, self.num_truth + other.num_truth)

    @classmethod
    def _merge(cls, scores: Float64, tp: Int64, fp: Int64, num_truth: int) -> "Ranking":
        falling, at = np.unique(-scores, return_inverse=True)
        hits, alarms = (np.bincount(at, part, len(falling)).astype(np.int64) for part in (tp, fp))
        return cls(-falling, hits, alarms, num_truth)

    @property
    def reason(self) -> str | None:
        """Why there is no curve."""
        if not self.num_truth:
            return "no truth boxes"
        if not len(self.scores):
            return "no estimates"
        return "results have no scores" if len(self.scores) == 1 and self.scores[0] == 0 else None

    def best_f1(self) -> tuple[float, float]:
        """Highest F1 of all thresholds, and the highest threshold that gives it."""
        tp, fp = np.cumsum(self.tp), np.cumsum(self.fp)
        f1 = 2 * tp / (tp + fp + self.num_truth)
        best = int(np.argmax(f1))
        return float(f1[best]), float(self.scores[best])

    def curve(self) -> tuple[Float64, Float64]:
        """Return recall (U,) and precision (U,) at each threshold, the highest first; only where there is a curve."""
        tp, fp = np.cumsum(self.tp), np.cumsum(self.fp)
        return tp / self.num_truth, tp / (tp + fp)

    def average_precision(self) -> float:
        """Mean over recall 0, 0.01 ... 1 of the best precision there or beyond (COCO); equal scores go together."""
        tp, fp = np.cumsum(self.tp), np.cumsum(self.fp)
        precision = np.maximum.accumulate((tp / (tp + fp))[::-1])[::-1]
        at = np.searchsorted(tp / self.num_truth, _RECALLS, side="left")
        return float(np.append(precision, 0.0)[at].mean())


@dataclass(frozen=True)
class DetectionCounts(Counts):
    """Sufficient statistics of one class."""

    boxes: BoxCounts = field(default_factory=BoxCounts)  # At the score threshold that the results have
    ranking: Ranking = field(default_factory=lambda: Ranking.of(np.zeros(0), np.zeros(0, bool), 0))
    distance: Deviation = field(default_factory=Deviation)  # [m]
    range_rate: Deviation = field(default_factory=Deviation)  # [m/s]
    ranges: RangeCounts = field(default_factory=RangeCounts)


def detection_counts(sequence: Sequence, group: Group, match: Match) -> DetectionCounts:
    """Match and count one class of one sequence. Raises MetricError where boxes lack what the match compares."""
    candidates = outcomes.compare_class(sequence, group, match)
    found, ranked = outcomes.judge_detections(candidates), outcomes.judge_ranked(candidates)
    score = candidates.estimates.score
    counts = ranked.is_used & np.isfinite(score)
    ranking = Ranking.of(score[counts], ranked.outcome[counts] == Outcome.HIT, len(candidates.truth_row))
    hit = np.isin(np.arange(len(candidates.truth_row)), found.truth_of_estimate)
    ranges = RangeCounts.of(ground_range(candidates.truth), hit)
    hits = np.flatnonzero(found.truth_of_estimate >= 0)
    truth, estimates = candidates.truth_row[found.truth_of_estimate[hits]], candidates.estimates[hits]
    if estimates.distance_m is None and estimates.range_rate_mps is None:
        return DetectionCounts(found.counts, ranking, ranges=ranges)
    distance, rate = sequence.truth.distance_m, range_rates(sequence)
    return DetectionCounts(
        found.counts, ranking, Deviation.of(None if distance is None else distance[truth], estimates.distance_m),
        Deviation.of(None if rate is None else rate[truth], estimates.range_rate_mps), ranges,
    )  # fmt: skip


def detection_rows(n: DetectionCounts, head: ScoreKey) -> list[Score]:
    """Return F1, precision and recall at the operating point."""
    boxes = n.boxes
    predicted = {"predicted": boxes.predicted} if boxes.predicted else {}
    counts = {**boxes.as_dict(), **predicted, "frames": head.num_frames}
    table = (
        ("f1", boxes.tp + boxes.fn / 2 + boxes.fp / 2, "no truth and no estimates"),
        ("precision", boxes.estimates, "no estimates"),
        ("recall", boxes.gt, "no truth boxes"),
    )
    return [head.ratio(metric, boxes.tp, bottom, head.reason or why, counts) for metric, bottom, why in table]


def curve_rows(n: DetectionCounts, head: ScoreKey) -> list[Score]:
    """Return what depends on scores: the best F1 with its threshold, and average precision."""
    reason = head.reason or n.ranking.reason
    best, threshold = (None, None) if reason else n.ranking.best_f1()
    ap = None if reason else n.ranking.average_precision()
    counts = {"gt": n.ranking.num_truth, "frames": head.num_frames}
    table = (("best_f1", best), ("best_f1_threshold", threshold), ("ap", ap))
    return [head.score(metric, value, reason, counts) for metric, value in table]


def deviation_rows(n: DetectionCounts, head: ScoreKey) -> list[Score]:
    """Return the mean absolute errors of distance [m] and range rate [m/s] of the hits."""
    table = (
        ("distance_error", n.distance, "m", "its distance"),
        ("range_rate_error", n.range_rate, "m/s", "its range rate"),
    )
    rows = []
    for metric, error, unit, what in table:
        total, why = float(error.total), head.reason or f"no hit tells {what}"
        rows.append(head.ratio(metric, total, error.num, why, {"hits": error.num, "error_sum": total}, unit))
    return rows
