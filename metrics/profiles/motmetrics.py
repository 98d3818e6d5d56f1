"""The profile `motmetrics`: the numbers of py-motmetrics 1.4.0's `motchallenge_metrics`."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Self

from fbench.metrics.core.problem import Problem
from fbench.metrics.profiles.trackeval.fields import (
    NO_MATCH,
    NO_RESULTS,
    NO_TRUTH,
    NOTHING,
    ClassCounts,
    TrackingCounts,
    clear_raw,
    identity_raw,
)
from fbench.metrics.profiles.trackeval.prepare import EVERYTHING, HALF, Preparation, problems
from fbench.metrics.tracking.clear import ClearCounts, ClearRules, clear_counts
from fbench.metrics.tracking.identity import IdentityCounts, identity_counts
from fbench.replay.contracts.profiles import Facts, Headlines, Match
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence

MOTMETRICS_RULES = ClearRules(
    margin=0.0, memory="last match", settle_first=True, most_pairs=True, own_frames=True, tracked_inclusive=True,
    counts_one_sided=True,
)  # fmt: skip
"""`mot.py` and `metrics.py` there: a truth track stays with the id of its last match, after any gap, while the two are
near enough; all others are assigned so that most pairs, and of these the nearest, come about."""
Value = tuple[str, float | Fraction | None, str, str]  # Metric, value, why it is undefined, unit

_FACTS = Facts(
    judges_tracks=True, space="2d", family="mot",
    headlines=Headlines(
        ("mota", "motp", "idf1", "idp", "idr", "recall", "precision", "num_switches", "num_fragmentations",
         "num_false_positives", "num_misses", "mostly_tracked", "partially_tracked", "mostly_lost")
    ),
)  # fmt: skip


@dataclass(frozen=True)
class MotmetricsProfile:
    """CLEAR and Identity by py-motmetrics' rules.

    Its own reader rounds some numbers of a file in the last digit, which tells only where two boxes overlap by exactly
    the threshold; and it prints nan for the `motp` of several sequences of which one has no match.
    """

    name: str = "motmetrics"
    summary: str = "CLEAR and IDF1 of all boxes as one class, as py-motmetrics 1.4.0 counts"
    preparation: Preparation = EVERYTHING
    match: Match = HALF
    rules: ClearRules = MOTMETRICS_RULES  # The floor comes from `match`

    @property
    def facts(self) -> Facts:
        """What it judges, and what it needs for that."""
        return _FACTS

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored; empty: any are."""
        return frozenset()

    def with_match(self, match: Match) -> Self:
        """Return the profile with another likeness or threshold."""
        return replace(self, match=match)

    def measure(self, sequence: Sequence) -> TrackingCounts:
        """Return the statistics of one sequence. Raises MetricError where an id is missing, or twice in a frame
        (GT003).
        """
        found = problems(sequence, self.preparation, self.match)
        names = (rule.name for rule in self.preparation.classes)
        return TrackingCounts({name: self._counts(one) for name, one in zip(names, found, strict=True)})

    def scores(self, statistics: TrackingCounts, part: str) -> list[Score]:
        """Return one row a number, in py-motmetrics' order and by its names."""
        return [row for name, own in statistics.classes.items() for row in self._rows(name, own, part)]

    def clear_rules(self) -> ClearRules:
        """Return the rules of CLEAR with the floor of the match; costs are 1 - IoU, or distances."""
        return replace(self.rules, floor=self.match.floor, offset=0.0 if self.match.is_distance else -1.0)

    def _counts(self, problem: Problem) -> ClassCounts:
        """Similarities are rounded as 1 - IoU, which is compared there, rounds them."""
        own = problem if self.match.is_distance else replace(problem, similarity=1.0 - (1.0 - problem.similarity))
        clear, identity = clear_counts(own, self.clear_rules()), identity_counts(own, self.match.floor)
        return ClassCounts(clear, identity, num_result_tracks=problem.num_estimate_ids)

    def _rows(self, name: str, own: ClassCounts, part: str) -> Iterator[Score]:
        unit = "m" if self.match.is_distance else "1"
        values = [*_identity(own.identity), *_clear(own.clear, unit)]
        raw = clear_raw(own.clear) | identity_raw(own.identity)
        for metric, value, why, of in values:
            number = None if value is None else float(value)
            yield Score(metric, name, part, str(self.match), number, why if value is None else None, of, raw)


def _identity(c: IdentityCounts) -> list[Value]:
    return [
        _ratio("idf1", 2 * c.tp, 2 * c.tp + c.fn + c.fp, NOTHING),
        _ratio("idp", c.tp, c.tp + c.fp, NO_RESULTS),
        _ratio("idr", c.tp, c.tp + c.fn, NO_TRUTH),
    ]


def _clear(c: ClearCounts, unit: str) -> list[Value]:
    """`motp` is the mean distance of matches: 1 - IoU, or [m]."""
    distance = -c.similarity if unit == "m" else c.tp - c.similarity
    counts = {
        "num_unique_objects": c.num_tracks, "mostly_tracked": c.mostly_tracked, "partially_tracked": c.partly_tracked,
        "mostly_lost": c.mostly_lost, "num_false_positives": c.fp, "num_misses": c.fn, "num_switches": c.switches,
        "num_fragmentations": c.fragmentations,
    }  # fmt: skip
    extra = {"num_transfer": c.transfers, "num_ascend": c.ascends, "num_migrate": c.migrations}
    wrong = "nan or -inf" if c.fp else "nan"
    return [
        _ratio("recall", c.tp, c.num_truth, NO_TRUTH),
        _ratio("precision", c.tp, c.tp + c.fp, NO_RESULTS),
        *((metric, value, "", "1") for metric, value in counts.items()),
        _ratio("mota", c.tp - c.fp - c.switches, c.num_truth, NO_TRUTH, wrong),
        _ratio("motp", distance, c.tp, NO_MATCH, "nan", unit),
        *((metric, value, "", "1") for metric, value in extra.items()),
    ]


def _ratio(metric: str, top: int | Fraction, bottom: int, why: str, printed: str = "nan", unit: str = "1") -> Value:
    value = Fraction(top) / bottom if bottom else None
    return metric, value, f"{why} (py-motmetrics prints {printed})", unit


MOTMETRICS = MotmetricsProfile()
