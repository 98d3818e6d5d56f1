"""The profile `default`: fbench's own scores, for results in files."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from fbench.metrics.core.exact import Counts
from fbench.metrics.core.ordering import content_order
from fbench.metrics.core.slices import VEHICLE, ScoreCounts, ScoreKey, add_counts, find_labels, label_group
from fbench.metrics.detection.horizon import horizon_rows
from fbench.metrics.detection.scores import DetectionCounts, curve_rows, detection_counts, detection_rows
from fbench.metrics.tracking.scores import TrackingCounts, require_unique_ids, tracking_counts, tracking_rows
from fbench.replay.contracts.profiles import Facts, Headlines, Match
from fbench.replay.data.boxes import LABELS
from fbench.replay.data.classes import label
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Objects, Sequence

IN_SPACE, IN_IMAGES = Match("bev", 2.0), Match("iou2d", 0.5)


@dataclass(frozen=True)
class Both(Counts):
    """Detections and tracks of one class are the same boxes here."""

    detection: DetectionCounts
    tracking: TrackingCounts


@dataclass(frozen=True)
class DefaultStatistics:
    """Counts by class."""

    entries: tuple[ScoreCounts[Both], ...]

    def __add__(self, other: "DefaultStatistics") -> "DefaultStatistics":
        return DefaultStatistics(add_counts([self.entries, other.entries]))


@dataclass(frozen=True)
class DefaultProfile:
    """Detection at the operating point, CLEAR MOT, identity and HOTA, for all vehicles as one class and each label.

    Labels of the source become those of fbench; boxes without any count as vehicles. Truth marked as ignored excuses
    what is found there.
    """

    match: Match = IN_SPACE
    name: str = "default"
    summary: str = "precision, recall, F1, CLEAR MOT, IDF1 and HOTA as fbench scores its runs"

    facts: ClassVar[Facts] = Facts(
        judges_tracks=True, space="both",
        headlines=Headlines(
            ("f1", "precision", "recall", "ap", "mota", "mota_no_fp", "motp", "idf1", "hota", "deta", "assa", "loca",
             "idsw", "frag", "mt", "ml")
        ),
    )  # fmt: skip
    result_labels: ClassVar[frozenset[str]] = frozenset()

    def with_match(self, match: Match) -> Self:
        """Return the profile with another rule of what matches; any will do."""
        return replace(self, match=match)

    def measure(self, sequence: Sequence) -> DefaultStatistics:
        """Return statistics. MetricError: boxes lack what is compared, or an id is twice in a class's frame (GT003)."""
        truth, estimates = _name_classes(sequence.truth), _name_classes(sequence.estimates)
        known, met = replace(sequence, truth=truth, estimates=estimates), find_labels(truth, estimates)
        groups = [VEHICLE] if met & {*VEHICLE.labels, ""} or not met else []
        entries = []
        for group in (*groups, *(label_group(name) for name in LABELS if name in met)):
            own = replace(known, truth=truth[group.holds(truth)], estimates=estimates[group.holds(estimates)])
            require_unique_ids(own)
            counts = Both(detection_counts(known, group, self.match), tracking_counts(known, group, self.match))
            entries.append(ScoreCounts(ScoreKey(group.name, "all", str(self.match), None, len(sequence.steps)), counts))
        return DefaultStatistics(tuple(entries))

    def scores(self, statistics: DefaultStatistics, part: str) -> list[Score]:
        """Return rows of all vehicles, then of each label."""
        names, rows = (VEHICLE.name, *LABELS), []
        for entry in sorted(statistics.entries, key=lambda entry: names.index(entry.key.class_)):
            head, counts = replace(entry.key, slice=part), entry.counts
            rows += detection_rows(counts.detection, head)
            rows += tracking_rows(counts.tracking, head, "m" if self.match.is_distance else "iou")
            rows += curve_rows(counts.detection, head)
            rows += horizon_rows(counts.detection.ranges, counts.detection.boxes.gt, head)
        return rows


def _name_classes(objects: Objects) -> Objects:
    """In the order of their content, by the names of fbench."""
    words, which = np.unique(objects.label, return_inverse=True)
    names = np.array([label(str(word)) for word in words], np.str_)
    named = replace(objects, label=names[which] if len(words) else objects.label)
    return named[content_order(named)]
