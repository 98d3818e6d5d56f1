"""The profile `default`: fbench's own scores, for results in files."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from fbench.metrics.core.ordering import content_order
from fbench.metrics.core.slices import VEHICLE, Entry, Group, Heading, add_entries, label_group
from fbench.metrics.detection.scores import DetectionCounts, curve_rows, detection_counts, detection_rows
from fbench.metrics.tracking.scores import TrackingCounts, require_unique_ids, tracking_counts, tracking_rows
from fbench.replay.contracts.profiles import Facts, Headlines, Match
from fbench.replay.data.boxes import LABELS
from fbench.replay.data.classes import label
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Objects, Sequence

IN_SPACE, IN_IMAGES = Match("bev", 2.0), Match("iou2d", 0.5)


@dataclass(frozen=True)
class Both:
    """Detections and tracks of one class are the same boxes here."""

    detection: DetectionCounts
    tracking: TrackingCounts

    def __add__(self, other: "Both") -> "Both":
        return Both(self.detection + other.detection, self.tracking + other.tracking)


@dataclass(frozen=True)
class DefaultStatistics:
    """Counts by class."""

    entries: tuple[Entry[Both], ...]

    def __add__(self, other: "DefaultStatistics") -> "DefaultStatistics":
        return DefaultStatistics(add_entries([self.entries, other.entries]))


_FACTS = Facts(
    judges_tracks=True, space="both",
    headlines=Headlines(
        ("f1", "precision", "recall", "ap", "mota", "mota_no_fp", "motp", "idf1", "hota", "deta", "assa", "loca",
         "idsw", "frag", "mt", "ml")
    ),
)  # fmt: skip


@dataclass(frozen=True)
class DefaultProfile:
    """Detection at the operating point, CLEAR MOT, identity and HOTA, for all vehicles as one class and each label.

    Labels of the source become those of fbench; boxes without any count as vehicles. Truth marked as ignored excuses
    what is found there.
    """

    match: Match = IN_SPACE
    name: str = "default"
    summary: str = "precision, recall, F1, CLEAR MOT, IDF1 and HOTA as fbench scores its runs"

    @property
    def facts(self) -> Facts:
        """What it judges, and what it needs for that."""
        return _FACTS

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored; empty: any are."""
        return frozenset()

    def with_match(self, match: Match) -> Self:
        """Return the profile with another rule of what matches; any will do."""
        return replace(self, match=match)

    def measure(self, sequence: Sequence) -> DefaultStatistics:
        """Return the statistics of one sequence. Raises MetricError where boxes lack what the match compares, or an id
        is twice in one frame of a class (GT003).
        """
        known = replace(sequence, truth=_name_classes(sequence.truth), estimates=_name_classes(sequence.estimates))
        return DefaultStatistics(tuple(self._entry(known, group) for group in _groups(known)))

    def scores(self, statistics: DefaultStatistics, part: str) -> list[Score]:
        """Return rows of all vehicles, then of each label."""
        entries = sorted(statistics.entries, key=lambda entry: _rank(entry.heading.class_))
        return [row for entry in entries for row in self._rows(entry, part)]

    def _entry(self, sequence: Sequence, group: Group) -> Entry[Both]:
        require_unique_ids(_of_class(sequence, group))
        counts = Both(detection_counts(sequence, group, self.match), tracking_counts(sequence, group, self.match))
        return Entry(Heading(group.name, "all", str(self.match), None, len(sequence.steps)), counts)

    def _rows(self, entry: Entry[Both], part: str) -> list[Score]:
        head = replace(entry.heading, slice=part)
        rows = detection_rows(entry.counts.detection, head)
        rows += tracking_rows(entry.counts.tracking, head, "m" if self.match.is_distance else "iou")
        return rows + curve_rows(entry.counts.detection, head)


def _of_class(sequence: Sequence, group: Group) -> Sequence:
    truth, estimates = (objects[group.holds(objects)] for objects in (sequence.truth, sequence.estimates))
    return replace(sequence, truth=truth, estimates=estimates)


def _groups(sequence: Sequence) -> Iterable[Group]:
    asked = sequence.truth.label
    if sequence.truth.ignore is not None:
        asked = asked[~sequence.truth.ignore]
    met = {*np.unique(asked).tolist(), *np.unique(sequence.estimates.label).tolist()}
    if met & {*VEHICLE.labels, ""} or not met:
        yield VEHICLE
    yield from (label_group(name) for name in LABELS if name in met)


def _name_classes(objects: Objects) -> Objects:
    """In the order of their content, by the names of fbench."""
    words, which = np.unique(objects.label, return_inverse=True)
    names = np.array([label(str(word)) for word in words], np.str_)
    named = replace(objects, label=names[which] if len(words) else objects.label)
    return named[content_order(named)]


def _rank(name: str) -> int:
    return -1 if name == VEHICLE.name else LABELS.index(name) if name in LABELS else len(LABELS)
