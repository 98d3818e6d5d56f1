"""Precision, recall and F1 of detections, and what other score thresholds would have given."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fbench.metrics.profile import Match
from fbench.metrics.sequence import Sequence
from fbench.metrics.standard.counted import Alike, alike, counted
from fbench.metrics.standard.counts import BoxCounts
from fbench.metrics.standard.deviation import Deviation, range_rates
from fbench.metrics.standard.entries import Heading
from fbench.metrics.standard.groups import Group
from fbench.metrics.standard.judge import Judgement, Outcome, judge_detections, judge_ranked
from fbench.metrics.standard.ranking import Ranking
from fbench.metrics.standard.slices import Part
from fbench.replay.scores import Score, ratio


def _no_ranking() -> Ranking:
    return Ranking.of(np.zeros(0), np.zeros(0, bool), 0)


@dataclass(frozen=True)
class DetectionCounts:
    """Sufficient statistics of one class."""

    boxes: BoxCounts = field(default_factory=BoxCounts)
    """At the score threshold that the results have."""
    ranking: Ranking = field(default_factory=_no_ranking)
    distance: Deviation = field(default_factory=Deviation)
    """[m]"""
    range_rate: Deviation = field(default_factory=Deviation)
    """[m/s]"""

    def __add__(self, other: "DetectionCounts") -> "DetectionCounts":
        return DetectionCounts(
            self.boxes + other.boxes, self.ranking + other.ranking, self.distance + other.distance,
            self.range_rate + other.range_rate,
        )  # fmt: skip


def detection_counts(sequence: Sequence, group: Group, match: Match) -> DetectionCounts:
    """Match and count one class of one sequence.

    Raises:
        MetricError: where boxes lack what the match compares.
    """
    held = counted(alike(sequence, group, match))
    found = judge_detections(held)
    ranked = judge_ranked(held)
    counts = np.isin(ranked.outcome, [Outcome.HIT, Outcome.FALSE_ALARM, Outcome.INVALID])
    counts &= np.isfinite(held.score)
    ranking = Ranking.of(held.score[counts], ranked.outcome[counts] == Outcome.HIT, len(held.truth_row))
    return DetectionCounts(found.counts, ranking, *_deviations(sequence, found))


def part_counts(pairs: Alike, part: Part) -> DetectionCounts:
    """Count a part of a sequence at the score threshold that the results have, and nothing else."""
    return DetectionCounts(judge_detections(counted(pairs, part)).counts)


def _deviations(sequence: Sequence, found: Judgement) -> tuple[Deviation, Deviation]:
    hits = np.flatnonzero(found.truth_of_estimate >= 0)
    truth = found.counted.truth_row[found.truth_of_estimate[hits]]
    estimates = found.counted.estimates[hits]
    if estimates.distance_m is None and estimates.range_rate_mps is None:
        return Deviation(), Deviation()
    distance, rate = sequence.truth.distance_m, range_rates(sequence)
    return (
        Deviation.of(None if distance is None else distance[truth], estimates.distance_m),
        Deviation.of(None if rate is None else rate[truth], estimates.range_rate_mps),
    )


def detection_rows(n: DetectionCounts, head: Heading) -> list[Score]:
    """Return F1, precision and recall at the operating point."""
    boxes = n.boxes
    table: Mapping[str, tuple[float, float, str]] = {
        "f1": (boxes.tp, boxes.tp + boxes.fn / 2 + boxes.fp / 2, "no truth and no estimates"),
        "precision": (boxes.tp, boxes.estimates, "no estimates"),
        "recall": (boxes.tp, boxes.gt, "no truth boxes"),
    }
    counts = {**boxes.named(with_predicted=True), "frames": head.num_frames}
    return [
        ratio(metric, head.class_, head.matching, top, bottom, head.reason or why, counts, part=head.slice)
        for metric, (top, bottom, why) in table.items()
    ]


def curve_rows(n: DetectionCounts, head: Heading) -> list[Score]:
    """Return what depends on scores: the best F1 with its threshold, and average precision."""
    reason = head.reason or n.ranking.reason
    best, threshold = (None, None) if reason else n.ranking.best_f1()
    ap = None if reason else n.ranking.average_precision()
    counts = {"gt": n.ranking.num_truth, "frames": head.num_frames}
    return [
        Score(metric, head.class_, head.slice, head.matching, value, reason, "1", counts)
        for metric, value in (("best_f1", best), ("best_f1_threshold", threshold), ("ap", ap))
    ]


def deviation_rows(n: DetectionCounts, head: Heading) -> list[Score]:
    """Return the mean absolute errors of distance [m] and range rate [m/s] of the hits."""
    return [
        ratio(
            metric, head.class_, head.matching, float(error.total), error.num, head.reason or f"no hit tells {what}",
            {"hits": error.num, "error_sum": float(error.total)}, unit, head.slice,
        )
        for metric, error, unit, what in (
            ("distance_error", n.distance, "m", "its distance"),
            ("range_rate_error", n.range_rate, "m/s", "its range rate"),
        )
    ]  # fmt: skip
