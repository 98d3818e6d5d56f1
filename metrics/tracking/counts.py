"""Statistics of tracking by class."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import reduce
from operator import add

from fbench.metrics.tracking.clear import ClearCounts
from fbench.metrics.tracking.hota import HotaCounts
from fbench.metrics.tracking.identity import IdentityCounts


@dataclass(frozen=True)
class ClassCounts:
    """CLEAR, Identity and HOTA of one class."""

    clear: ClearCounts = field(default_factory=ClearCounts)
    identity: IdentityCounts = field(default_factory=IdentityCounts)
    hota: HotaCounts = field(default_factory=HotaCounts)
    num_result_tracks: int = 0

    def __add__(self, other: "ClassCounts") -> "ClassCounts":
        return ClassCounts(
            self.clear + other.clear,
            self.identity + other.identity,
            self.hota + other.hota,
            self.num_result_tracks + other.num_result_tracks,
        )

    @property
    def num_boxes(self) -> int:
        """Truth boxes and results that aren't matches."""
        return self.clear.tp + self.clear.fn + self.clear.fp


@dataclass(frozen=True)
class TrackingCounts:
    """Statistics of all classes."""

    classes: Mapping[str, ClassCounts]
    """By name, in the profile's order."""

    def __add__(self, other: "TrackingCounts") -> "TrackingCounts":
        names = dict.fromkeys((*self.classes, *other.classes))
        none = ClassCounts()
        return TrackingCounts({n: self.classes.get(n, none) + other.classes.get(n, none) for n in names})

    @property
    def together(self) -> ClassCounts:
        """All classes as one, as if each were a sequence."""
        return reduce(add, self.classes.values(), ClassCounts())
