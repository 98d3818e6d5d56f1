"""The profile `nuscenes-tracking`."""

from dataclasses import dataclass, field, replace
from typing import Self

from fbench.metrics.nuscenes.checks import check_tracked
from fbench.metrics.nuscenes.clip import TrackingStatistics, clips_of
from fbench.metrics.nuscenes.counted import counted
from fbench.metrics.nuscenes.match_rule import center_distance
from fbench.metrics.nuscenes.settings import TrackingSettings
from fbench.metrics.nuscenes.tracking_rows import tracking_rows
from fbench.metrics.nuscenes.tracks import track_points
from fbench.metrics.profile import Match
from fbench.metrics.sequence import Sequence
from fbench.replay.scores import Score


@dataclass(frozen=True)
class NuscenesTracking:
    """nuScenes' tracking benchmark (AMOTA, AMOTP and CLEAR at the best score) as nuscenes-devkit 1.2.0 counts it.

    A sequence is a scene, its steps are samples; boxes are in coordinates that don't move with the ego. Its quirks,
    which no other profile has: a box has the mean score of its track; tracks, of truth and results, are filled in at
    samples where they miss, from before and after, with weights the wrong way round; MOTA is floored at 0; what is
    averaged over recalls takes the worst value where a recall isn't reached.
    Where the devkit goes by the order in the file (two truth boxes that both want to go on with one track), this one
    goes by content. The devkit's distances lose digits far from the origin, by expanding the square; these don't.
    """

    settings: TrackingSettings = field(default_factory=TrackingSettings)
    name: str = "nuscenes-tracking"
    summary: str = "tracking_nips_2019 as nuscenes-devkit 1.2.0 with motmetrics 1.4.0 counts it"

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return frozenset(self.settings.rules.classes)

    def with_match(self, match: Match) -> Self:
        """Return the profile with another distance.

        Raises:
            ConfigError: where it isn't a distance between centres in the ground plane.
        """
        return replace(self, settings=replace(self.settings, distance_m=center_distance(self.name, match)))

    def measure(self, sequence: Sequence) -> TrackingStatistics:
        """Return what is near what in one sequence.

        Raises:
            MetricError: where it can't be scored: an id twice in a sample (GT003), boxes without track, no boxes in
                space, too many results.
        """
        boxes = counted(sequence, self.settings.rules)
        check_tracked(sequence, "truth", boxes.truth.boxes)
        check_tracked(sequence, "a result", boxes.estimates.boxes)
        truth, estimates = track_points(sequence, boxes.truth), track_points(sequence, boxes.estimates)
        num_classes = len(self.settings.rules.classes)
        clips = clips_of(
            sequence.name, truth, estimates, len(sequence.steps), num_classes, self.settings.distance_m
        )  # fmt: skip
        return TrackingStatistics(clips, boxes.left_out)

    def scores(self, statistics: TrackingStatistics, part: str) -> list[Score]:
        """Return all metrics over the classes, then of each class."""
        return tracking_rows(self.settings, statistics, part)
