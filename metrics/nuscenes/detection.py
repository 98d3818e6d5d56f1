"""The profile `nuscenes-detection`."""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from fbench.metrics.nuscenes.counted import Counted, counted
from fbench.metrics.nuscenes.detection_rows import detection_rows
from fbench.metrics.nuscenes.errors import ERRORS, match_errors
from fbench.metrics.nuscenes.grouping import centers_xy, sorted_groups
from fbench.metrics.nuscenes.match_rule import center_distance
from fbench.metrics.nuscenes.ranking import DetectionStatistics, Ranking
from fbench.metrics.nuscenes.settings import DetectionSettings
from fbench.metrics.profile import Match
from fbench.metrics.sequence import Sequence
from fbench.replay.arrays import Float64, Int64
from fbench.replay.scores import Score


@dataclass(frozen=True)
class NuscenesDetection:
    """nuScenes' detection benchmark (AP by centre distance, five errors, NDS) as nuscenes-devkit 1.2.0 counts it.

    A sequence is a scene, its steps are samples; boxes are in coordinates that don't move with the ego. Where the
    devkit goes by the order in the file (equal scores, truth at equal distances), this one goes by content.
    """

    settings: DetectionSettings = field(default_factory=DetectionSettings)
    name: str = "nuscenes-detection"
    summary: str = "detection_cvpr_2019 as nuscenes-devkit 1.2.0 counts it"

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return frozenset(self.settings.rules.classes)

    def with_match(self, match: Match) -> Self:
        """Return the profile with one distance for AP and errors.

        Raises:
            ConfigError: where it isn't a distance between centres in the ground plane.
        """
        distance_m = center_distance(self.name, match)
        settings = replace(self.settings, distances_m=(distance_m,), error_distance_m=distance_m)
        return replace(self, settings=settings)

    def measure(self, sequence: Sequence) -> DetectionStatistics:
        """Return what each result of one sequence hit.

        Raises:
            MetricError: where it can't be scored: an id twice in a sample (GT003), no boxes in space, too many results.
        """
        boxes = counted(sequence, self.settings.rules)
        order, partner = self._matches(boxes, len(sequence.steps))
        return DetectionStatistics((self._ranking(sequence, boxes, order, partner),), boxes.left_out)

    def scores(self, statistics: DetectionStatistics, part: str) -> list[Score]:
        """Return NDS, mAP and mean errors, then AP and errors of each class."""
        return detection_rows(self.settings, statistics, part)

    def _matches(self, boxes: Counted, num_steps: int) -> tuple[Int64, Int64]:
        """Return the order (M,) in which estimates choose, and the truth row (M, D) of each in that order, or -1."""
        from fbench.metrics.kernels.nuscenes_match import match_nearest  # numba takes a while to import

        num_classes = len(self.settings.rules.classes)
        rows, truth_start = sorted_groups(boxes.truth, num_classes, num_steps)
        order, estimate_start = sorted_groups(boxes.estimates, num_classes, num_steps, by_score=True)
        truth_xy, estimate_xy = centers_xy(boxes.truth)[rows], centers_xy(boxes.estimates)[order]
        limits_m = np.array(self.settings.distances_m, np.float64)
        invalid = boxes.estimates.invalid[order]
        partner = match_nearest(truth_xy, truth_start, estimate_xy, estimate_start, invalid, limits_m)
        return order, np.append(rows, -1)[partner]

    def _ranking(self, sequence: Sequence, boxes: Counted, order: Int64, partner: Int64) -> Ranking:
        step = boxes.estimates.boxes.step[order]
        score = boxes.estimates.boxes.score[order]
        of_error = partner[:, self.settings.error_index]
        has_error = of_error >= 0
        return Ranking(
            sequence=sequence.name,
            num_truth=np.bincount(boxes.truth.kind, minlength=len(self.settings.rules.classes)),
            frame=sequence.steps.frame[step],
            place=order - np.searchsorted(boxes.estimates.boxes.step, step),
            kind=boxes.estimates.kind[order].astype(np.int8),
            score=np.where(np.isfinite(score), score, np.nan),
            hit=partner >= 0,
            error=_errors(boxes, of_error[has_error], order[has_error]),
            has_error=has_error,
        )


def _errors(boxes: Counted, truth: Int64, estimates: Int64) -> Float64:
    if not len(truth):
        return np.zeros((0, len(ERRORS)))
    return match_errors(boxes.truth.boxes[truth], boxes.estimates.boxes[estimates])
