"""Profiles: one benchmark's way to count, under its own name; packages add theirs through `fbench.profiles`."""

import math
from dataclasses import dataclass
from typing import Literal, Protocol, Self, TypeVar, get_args, runtime_checkable

from fbench.replay.contracts.errors import ConfigError, did_you_mean
from fbench.replay.data.scores import Score
from fbench.replay.data.sequences import Sequence, Space

SimilarityKind = Literal["iou2d", "ioubev", "iou3d", "let", "bev", "center3d", "plane"]
"""How alike two boxes are: intersection over union in the image, from above, in space, or in space with tolerance along
the line of sight; or how far apart: centers in the ground plane, centers in space, or the two corners nearest to the
ego (plane distance)."""
SIMILARITY_KINDS: tuple[SimilarityKind, ...] = get_args(SimilarityKind)
_DISTANCES: tuple[SimilarityKind, ...] = ("bev", "center3d", "plane")


@dataclass(frozen=True)
class Match:
    """When two boxes are the same object."""

    kind: SimilarityKind
    threshold: float  # Least intersection over union, or largest distance [m]

    def __post_init__(self) -> None:
        if self.is_distance and not 0 < self.threshold < math.inf:
            raise ConfigError(f"match {self.kind}:{self.threshold:g}: expected a distance above 0 m")
        if not self.is_distance and not 0 < self.threshold <= 1:
            raise ConfigError(f"match {self.kind}:{self.threshold:g}: expected above 0 and up to 1")

    @property
    def is_distance(self) -> bool:
        """Whether less is nearer."""
        return self.kind in _DISTANCES

    @property
    def floor(self) -> float:
        """Similarity from which on boxes match; distances are negated."""
        return -self.threshold if self.is_distance else self.threshold

    def __str__(self) -> str:
        return f"{self.kind} {self.threshold:g}{' m' if self.is_distance else ''}"

    @classmethod
    def parse(cls, text: str) -> "Match":
        """Read what follows `--match`: `iou3d:0.25`, `bev:2` ... Raises ConfigError where it isn't of this form."""
        name, _, number = text.partition(":")
        kind = next((known for known in SIMILARITY_KINDS if known == name), None)
        if kind is None:
            raise ConfigError(f"--match {text}: unknown '{name}'{did_you_mean(name, SIMILARITY_KINDS)}")
        try:
            return cls(kind, float(number))
        except ValueError:
            raise ConfigError(f"--match {text}: expected {name}:NUMBER") from None


Family = Literal["av2", "kitti-tracking", "mot", "nuscenes", "nuscenes-tracking"]
"""Benchmarks with one set of classes, called as the formats of `fbench log export` where there is one."""


@dataclass(frozen=True)
class Headlines:
    """Metrics of a profile that people look for."""

    metrics: tuple[str, ...] = ()  # In the order in which they are printed; empty: all of them
    all_matchings: bool = False
    """Whether one metric has rows for several ways of matching, of which each counts; else the first is shown."""
    has_levels: bool = False  # Whether rows are about levels of difficulty, `all, easy`, and none about all of them


@dataclass(frozen=True)
class Facts:
    """What a profile judges, and what it needs for that."""

    judges_tracks: bool
    space: Space  # Where its boxes must be; `both`: wherever the results have them
    family: Family | None = None  # By whose names classes go; `None`: by those of fbench
    headlines: Headlines = Headlines()
    needs_ego: bool = False  # Its ranges are about the ego, so that boxes in the world need the ego's position
    needs_time: bool = False  # Samples need an order in time
    ranks_by_file: bool = False  # Its tool ranks equal scores as the file has them, which changes AP
    cuts_up_to_1: bool = False  # It cuts results by their scores from 0 to 1, so that others aren't ranked


class Statistics(Protocol):
    """Sufficient statistics: what must be known of a sequence to give its numbers, and those of any sum.

    Adding in any order and grouping gives the same, bit for bit: counts are ints, sums of reals are `Fraction`s,
    lists are sorted by a total key before they are used.
    """

    def __add__(self, other: Self) -> Self: ...


S = TypeVar("S", bound=Statistics)


@runtime_checkable
class Profile(Protocol[S]):
    """One benchmark's way to count.

    Implementations are frozen dataclasses, so that thresholds, classes and filters are data that can be listed. An
    entry point names an object, or a class that is made without arguments.
    """

    @property
    def name(self) -> str:
        """As users say it: `kitti-3dmot`."""

    @property
    def summary(self) -> str:
        """One line: what it reproduces, and which version of what."""

    @property
    def facts(self) -> Facts:
        """What it judges, and what it needs for that."""

    @property
    def result_labels(self) -> frozenset[str]:
        """Labels of results that are scored; empty: any are."""

    def with_match(self, match: Match) -> Self:
        """Return the profile with another rule of matching. Raises ConfigError where the benchmark can't do that."""

    def measure(self, sequence: Sequence) -> S:
        """Return the statistics of one sequence; keeps nothing. Raises MetricError where truth or estimates can't be
        scored: an id twice in a frame (GT003), no boxes of the kind.
        """

    def scores(self, statistics: S, part: str) -> list[Score]:
        """Return the rows of a sequence or of a sum, primary ones first; `null` with a reason where undefined.

        Args:
            statistics: Of a sequence, or of several, added.
            part: What the rows are about, their `slice`.
        """
