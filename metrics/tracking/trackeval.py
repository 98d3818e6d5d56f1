"""HOTA, CLEAR and Identity as TrackEval 1.3.0 counts them (https://github.com/JonathonLuiten/TrackEval)."""

from dataclasses import dataclass, replace
from typing import Self

from fbench.metrics.problem import Problem
from fbench.metrics.profile import Match
from fbench.metrics.sequence import Sequence
from fbench.metrics.tracking.clear import TRACKEVAL_RULES, ClearRules, clear_counts
from fbench.metrics.tracking.counts import ClassCounts, TrackingCounts
from fbench.metrics.tracking.hota import hota_counts
from fbench.metrics.tracking.identity import identity_counts
from fbench.metrics.tracking.prepare import overlaps, problems
from fbench.metrics.tracking.rows import tracking_scores
from fbench.metrics.tracking.rules import HALF, KITTI, MOT15, MOT17, MOT20, Preparation
from fbench.replay.scores import Score


@dataclass(frozen=True)
class TrackEvalProfile:
    """HOTA at 19 thresholds, CLEAR and Identity at one, for each class of a benchmark."""

    name: str
    summary: str
    preparation: Preparation
    match: Match = HALF
    rules: ClearRules = TRACKEVAL_RULES
    """Floor and offset come from `match`."""

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return self.preparation.result_labels

    def with_match(self, match: Match) -> Self:
        """Return the profile with another likeness or threshold.

        Distances d rate matches as TrackEval rates them in MOT15's 3D: CLEAR by 1 - d / (2 threshold), its default,
        HOTA by max(0, 1 - d / threshold).
        """
        return replace(self, match=match)

    def measure(self, sequence: Sequence) -> TrackingCounts:
        """Return the statistics of one sequence.

        Raises:
            MetricError: where an id is missing or twice in a frame (GT003), or labels are of another benchmark.
        """
        found = problems(sequence, self.preparation, self.match)
        names = (rule.name for rule in self.preparation.classes)
        return TrackingCounts({name: self._counts(one) for name, one in zip(names, found, strict=True)})

    def scores(self, statistics: TrackingCounts, part: str) -> list[Score]:
        """Return rows of all classes: means over thresholds first, then those of each threshold.

        Over all sequences of several classes also their mean (`cls_comb_cls_av`) and their sum (`cls_comb_det_av`).
        """
        return tracking_scores(statistics, part, self.match)

    def clear_rules(self) -> ClearRules:
        """Return the rules of CLEAR with the floor of the match."""
        offset = 2 * self.match.threshold if self.match.is_distance else 0.0
        return replace(self.rules, floor=self.match.floor, offset=offset)

    def _counts(self, problem: Problem) -> ClassCounts:
        return ClassCounts(
            clear_counts(problem, self.clear_rules()),
            identity_counts(problem, self.match.floor),
            hota_counts(replace(problem, similarity=overlaps(problem, self.match))),
            problem.num_estimate_ids,
        )


TRACKEVAL_KITTI = TrackEvalProfile(
    "trackeval-kitti", "KITTI tracking in images, cars and pedestrians, as TrackEval 1.3.0 counts", KITTI
)
TRACKEVAL_MOT = TrackEvalProfile(
    "trackeval-mot", "MOTChallenge 16 and 17, pedestrians, as TrackEval 1.3.0 counts", MOT17
)
TRACKEVAL_MOT20 = TrackEvalProfile("trackeval-mot20", "MOTChallenge 20, pedestrians, as TrackEval 1.3.0 counts", MOT20)
TRACKEVAL_MOT15 = TrackEvalProfile(
    "trackeval-mot15", "MOTChallenge 15, truth without classes, as TrackEval 1.3.0 counts", MOT15
)
