"""The profile `kitti-object`: average precision of KITTI's object benchmark."""

from dataclasses import dataclass, replace
from typing import Self

from fbench.metrics.kitti.object_rules import CLASSES, DIFFICULTIES, Difficulty, ObjectClass
from fbench.metrics.kitti.object_scores import curve, object_scores
from fbench.metrics.kitti.object_table import ObjectTable, object_table
from fbench.metrics.profile import Likeness, Match
from fbench.metrics.sequence import Sequence
from fbench.replay.errors import ConfigError
from fbench.replay.scores import Score

_LIKENESSES: tuple[Likeness, ...] = ("iou2d", "ioubev", "iou3d")


@dataclass(frozen=True)
class ObjectStatistics:
    """Tables of sequences, one for each class and likeness of the profile.

    Thresholds depend on the scores of all sequences, so boxes are kept and counted at the end.
    """

    tables: tuple[tuple[ObjectTable, ...], ...]

    def __add__(self, other: "ObjectStatistics") -> "ObjectStatistics":
        return ObjectStatistics(self.tables + other.tables)


@dataclass(frozen=True)
class KittiObject:
    """KITTI's object devkit (Geiger et al., CVPR 2012; 40 recalls: Simonelli et al., ICCV 2019), as OpenPCDet 8cacccec
    has it in `kitti_object_eval_python`, but with overlaps in double precision.

    Truth rows choose in turn, so that where two of them compete for one result the order of rows decides; `sort`
    puts them in an order of their own, which the devkit doesn't. Where a threshold leaves neither a hit nor a false
    positive, precision is 0 there (NaN in OpenPCDet).
    """

    classes: tuple[ObjectClass, ...] = CLASSES
    difficulties: tuple[Difficulty, ...] = DIFFICULTIES
    sort: bool = False
    name: str = "kitti-object"
    summary: str = (
        "KITTI object AP and AOS over 40 and 11 recalls: in the image, from above, in 3D (OpenPCDet 8cacccec)"
    )

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored."""
        return frozenset(kind.label for kind in self.classes)

    def with_match(self, match: Match) -> Self:
        """Return the profile with one overlap for all classes.

        Raises:
            ConfigError: where it isn't an intersection over union.
        """
        if match.likeness not in _LIKENESSES:
            raise ConfigError(f"{self.name}: --match {match.likeness}: expected iou2d, ioubev or iou3d")
        return replace(self, classes=tuple(replace(kind, matches=(match,)) for kind in self.classes))

    def measure(self, sequence: Sequence) -> ObjectStatistics:
        """Return what counts in one sequence."""
        return ObjectStatistics(
            (
                tuple(
                    object_table(sequence, kind, self.difficulties, likeness, least, self.sort)
                    for kind, likeness, least in self._kinds()
                ),
            )
        )

    def scores(self, statistics: ObjectStatistics, part: str) -> list[Score]:
        """Return rows by class, match and difficulty."""
        position = {(kind.label, likeness): i for i, (kind, likeness, _) in enumerate(self._kinds())}
        rows = []
        for kind in self.classes:
            for match in kind.matches:
                tables = [own[position[kind.label, match.likeness]] for own in statistics.tables]
                for d, difficulty in enumerate(self.difficulties):
                    found = curve(tables, d, match.threshold)
                    rows += object_scores(found, kind, match, difficulty, part)
        return rows

    def _kinds(self) -> list[tuple[ObjectClass, Likeness, float]]:
        """Which tables there are: class, likeness and least overlap."""
        return [
            (kind, likeness, min(match.threshold for match in kind.matches if match.likeness == likeness))
            for kind in self.classes
            for likeness in _LIKENESSES
            if any(match.likeness == likeness for match in kind.matches)
        ]
