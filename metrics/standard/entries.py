"""Statistics with what they are about, so that those of several runs can be added."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from fbench.metrics.profile import Statistics

S = TypeVar("S", bound=Statistics)


@dataclass(frozen=True)
class Heading:
    """What the rows of one class in one space have in common."""

    class_: str
    slice: str
    matching: str
    reason: str | None
    """Why nothing can be scored."""
    num_frames: int
    """That were scored."""


@dataclass(frozen=True)
class Entry(Generic[S]):
    """The statistics of one class, slice and space."""

    heading: Heading
    counts: S

    @property
    def key(self) -> tuple[str, str, str]:
        """What tells it apart from others."""
        return self.heading.class_, self.heading.slice, self.heading.matching

    def __add__(self, other: "Entry[S]") -> "Entry[S]":
        one, two = self.heading, other.heading
        reason = one.reason if one.reason and two.reason else None
        heading = replace(one, reason=reason, num_frames=one.num_frames + two.num_frames)
        return Entry(heading, self.counts + other.counts)


def added(tables: Iterable[Iterable[Entry[S]]]) -> tuple[Entry[S], ...]:
    """Add the entries of several runs; what only some of them have stays, in the order in which it first comes."""
    sums: dict[tuple[str, str, str], Entry[S]] = {}
    for table in tables:
        for entry in table:
            sums[entry.key] = sums[entry.key] + entry if entry.key in sums else entry
    return tuple(sums.values())
