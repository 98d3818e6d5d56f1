"""The profile `coco`."""

from dataclasses import dataclass, field, replace
from typing import Self

from fbench.metrics.coco.measure import measure
from fbench.metrics.coco.rows import rows
from fbench.metrics.coco.rules import CocoRules
from fbench.metrics.coco.statistics import CocoStatistics
from fbench.metrics.profile import Match
from fbench.metrics.sequence import Sequence
from fbench.replay.errors import ConfigError
from fbench.replay.scores import Score


@dataclass(frozen=True)
class CocoProfile:
    """Average precision and recall of boxes in images as pycocotools 2.0.11 counts them (`COCOeval`, `bbox`).

    - Each step is an image; rankings of all images and sequences are pooled.
    - In an image the estimates of one class choose truth by score, up to 100; a truth box of the wrong size is
      ignored, as is an estimate of the wrong size that matches nothing; crowds (truth with `ignore`) excuse any number
      of estimates that lie in them by more than the threshold.
    - `ap`: mean over classes, 10 thresholds and 101 recalls of the best precision at or beyond each recall.
      `ar100`: mean over classes and thresholds of the recall with up to 100 estimates of a class in an image.
    - `aps`, `apm`, `apl`: boxes up to 32 x 32 px, 96 x 96 px, and larger ones.

    The area of truth is that of its box (COCO's files may say another, from a mask). Where pycocotools lets the order
    in the files decide, content does: equal scores stand by sequence, frame, camera, then rectangle; of truth boxes
    that an estimate overlaps equally the one with the lower left edge is taken, then the lower top edge.
    """

    rules: CocoRules = field(default_factory=CocoRules)
    classes: tuple[str, ...] = ()
    """Labels that count; empty: all that truth has."""
    name: str = "coco"
    summary: str = "average precision and recall in images, as pycocotools 2.0.11 (bbox)"

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return frozenset(self.classes)

    def with_match(self, match: Match) -> Self:
        """Return the profile with a single threshold.

        Raises:
            ConfigError: where it isn't an overlap in images.
        """
        if match.likeness != "iou2d":
            raise ConfigError(f"profile coco: can't match by {match.likeness}, use iou2d")
        return replace(self, rules=replace(self.rules, thresholds=(match.threshold,)))

    def measure(self, sequence: Sequence) -> CocoStatistics:
        """Return outcomes of the estimates of one sequence.

        Estimates that aren't finite or have a negative size are false alarms, such truth is left out and counted.

        Raises:
            MetricError: where boxes have no rectangles in images.
        """
        return measure(sequence, self.rules, self.classes)

    def scores(self, statistics: CocoStatistics, part: str) -> list[Score]:
        """Return COCO's twelve numbers, then average precisions of each class."""
        return rows(statistics, self.rules, self.classes, part)
