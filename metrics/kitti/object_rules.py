"""What KITTI's object benchmark counts and excuses, as data."""

from dataclasses import dataclass

from fbench.metrics.profile import Match


@dataclass(frozen=True)
class Difficulty:
    """Which truth must be found; results lower than the height are excused."""

    name: str
    min_height_px: float
    """Truth must be higher."""
    max_occlusion: int
    max_truncation: float


@dataclass(frozen=True)
class ObjectClass:
    """A class, its neighbour that is neither a hit nor a miss, and from which overlap on boxes match."""

    label: str
    neighbour: str
    matches: tuple[Match, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of truth that can take a result."""
        return (self.label, self.neighbour) if self.neighbour else (self.label,)


def _matches(strict: float, loose: float) -> tuple[Match, ...]:
    """The benchmark's overlaps, then the loose ones, which are the same in the image."""
    return (
        Match("iou2d", strict), Match("ioubev", strict), Match("iou3d", strict),
        Match("ioubev", loose), Match("iou3d", loose),
    )  # fmt: skip


CLASSES = (
    ObjectClass("car", "van", _matches(0.7, 0.5)),
    ObjectClass("pedestrian", "person_sitting", _matches(0.5, 0.25)),
    ObjectClass("cyclist", "", _matches(0.5, 0.25)),
)
DIFFICULTIES = (
    Difficulty("easy", 40.0, 0, 0.15),
    Difficulty("moderate", 25.0, 1, 0.3),
    Difficulty("hard", 25.0, 2, 0.5),
)
