"""The profile `motmetrics`: the numbers of py-motmetrics 1.4.0's `motchallenge_metrics`."""

from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

from fbench.metrics.core.problem import Problem
from fbench.metrics.profiles.trackeval import fields
from fbench.metrics.profiles.trackeval.fields import ClassCounts, Field, TrackingCounts
from fbench.metrics.profiles.trackeval.prepare import EVERYTHING
from fbench.metrics.profiles.trackeval.profiles import TracksProfile
from fbench.metrics.tracking.clear import ClearRules, clear_counts
from fbench.metrics.tracking.identity import identity_counts
from fbench.replay.contracts.profiles import Facts, Headlines
from fbench.replay.data.scores import Score

MOTMETRICS_RULES = ClearRules(
    margin=0.0, memory="last match", settle_first=True, most_pairs=True, own_frames=True, tracked_inclusive=True,
    counts_one_sided=True,
)  # fmt: skip
"""`mot.py` and `metrics.py` there: a truth track stays with the id of its last match, after any gap, while the two are
near enough; all others are assigned so that most pairs, and of these the nearest, come about."""
_share = partial(fields.share, text="nan", tool="py-motmetrics")


@dataclass(frozen=True)
class MotmetricsProfile(TracksProfile):
    """CLEAR and Identity by py-motmetrics' rules.

    Its own reader rounds some numbers of a file in the last digit, which tells only where two boxes overlap by exactly
    the threshold; and it prints nan for the `motp` of several sequences of which one has no match.
    """

    facts: ClassVar[Facts] = Facts(
        judges_tracks=True, space="2d", family="mot",
        headlines=Headlines(
            ("mota", "motp", "idf1", "idp", "idr", "recall", "precision", "num_switches", "num_fragmentations",
             "num_false_positives", "num_misses", "mostly_tracked", "partially_tracked", "mostly_lost")
        ),
    )  # fmt: skip

    def scores(self, statistics: TrackingCounts, part: str) -> list[Score]:
        """Return one row a number, in py-motmetrics' order and by its names."""
        return [
            field.score(name, part, str(self.match), fields.clear_raw(own.clear) | fields.identity_raw(own.identity))
            for name, own in statistics.classes.items()
            for field in self._fields(own)
        ]

    def count(self, problem: Problem) -> ClassCounts:
        """Count one class; costs are distances, or 1 - IoU, whose rounding similarities get."""
        floor, offset = self.match.floor, 0.0
        if not self.match.is_distance:
            problem, offset = problem.with_similarity(1.0 - (1.0 - problem.pairs.values)), -1.0
        clear = clear_counts(problem, replace(self.rules, floor=floor, offset=offset))
        return ClassCounts(clear, identity_counts(problem, floor), num_result_tracks=problem.num_estimate_ids)

    def _fields(self, counts: ClassCounts) -> list[Field]:
        """`motp` is the mean distance of matches: 1 - IoU, or [m]."""
        c, i, is_distance = counts.clear, counts.identity, self.match.is_distance
        distance, unit = (-c.similarity, "m") if is_distance else (c.tp - c.similarity, "1")
        boxes = {
            "num_unique_objects": c.num_tracks, "mostly_tracked": c.mostly_tracked,
            "partially_tracked": c.partly_tracked, "mostly_lost": c.mostly_lost, "num_false_positives": c.fp,
            "num_misses": c.fn, "num_switches": c.switches, "num_fragmentations": c.fragmentations,
        }  # fmt: skip
        ids = {"num_transfer": c.transfers, "num_ascend": c.ascends, "num_migrate": c.migrations}
        no_truth, wrong = fields.NO_TRUTH, "nan or -inf" if c.fp else "nan"
        return [
            _share("idf1", 2 * i.tp, 2 * i.tp + i.fn + i.fp, fields.NOTHING),
            _share("idp", i.tp, i.tp + i.fp, fields.NO_RESULTS),
            _share("idr", i.tp, i.tp + i.fn, no_truth),
            _share("recall", c.tp, c.num_truth, no_truth),
            _share("precision", c.tp, c.tp + c.fp, fields.NO_RESULTS),
            *(fields.count(metric, value) for metric, value in boxes.items()),
            _share("mota", c.tp - c.fp - c.switches, c.num_truth, no_truth, text=wrong),
            _share("motp", distance, c.tp, fields.NO_MATCH, unit=unit),
            *(fields.count(metric, value) for metric, value in ids.items()),
        ]


MOTMETRICS = MotmetricsProfile(
    "motmetrics", "CLEAR and IDF1 of all boxes as one class, as py-motmetrics 1.4.0 counts", EVERYTHING,
    rules=MOTMETRICS_RULES,
)  # fmt: skip
