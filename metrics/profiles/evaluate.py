"""Scoring of sequences one after the other, and all of them together."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Generic, TypeVar

from fbench.metrics.core.bootstrap import Bootstrap, with_intervals
from fbench.metrics.core.sequence import Sequence
from fbench.metrics.profiles.profile import Profile, Statistics
from fbench.replay.contracts.errors import MetricError
from fbench.replay.data.scores import Score

S = TypeVar("S", bound=Statistics)


@dataclass(frozen=True)
class Evaluation(Generic[S]):
    """Statistics of each sequence, in the order in which they came."""

    profile: Profile[S]
    statistics: dict[str, S]
    """By the sequence's name."""

    @property
    def total(self) -> S:
        """The sum over all sequences."""
        return reduce(add, self.statistics.values())

    def scores(self, how: Bootstrap | None = None) -> list[Score]:
        """Return rows over all sequences, then of each where there are several.

        Args:
            how: Resamples for confidence intervals of the numbers over all: what other sequences of their kind would
                give; none by default.
        """
        rows = self.profile.scores(self.total, "all") if how is None else self._with_intervals(how)
        if len(self.statistics) > 1:
            for name, own in self.statistics.items():
                rows += self.profile.scores(own, f"sequence {name}")
        return rows

    def _with_intervals(self, how: Bootstrap) -> list[Score]:
        return with_intervals(self.statistics, lambda total: self.profile.scores(total, "all"), how, "sequences")


def evaluate(profile: Profile[S], sequences: Iterable[Sequence]) -> Evaluation[S]:
    """Measure sequences one by one; only one is held at a time.

    Raises:
        MetricError: where there is no sequence, two have one name, or one can't be scored.
    """
    statistics: dict[str, S] = {}
    for sequence in sequences:
        if sequence.name in statistics:
            raise MetricError(f"two sequences are called '{sequence.name}'")
        statistics[sequence.name] = profile.measure(sequence)
    if not statistics:
        raise MetricError("no sequence to score")
    return Evaluation(profile, statistics)
