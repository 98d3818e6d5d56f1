"""What became of each box: hit, miss, false alarm, or neither."""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from fbench.metrics.matching.one_to_one import match_best, match_greedy
from fbench.metrics.standard.counted import Counted
from fbench.metrics.standard.counts import BoxCounts
from fbench.replay.arrays import Array, Bool, Int64


class Outcome(IntEnum):
    """Of an estimate."""

    HIT = 0
    FALSE_ALARM = 1
    INVALID = 2
    """A false alarm because it isn't finite, or has a negative size."""
    OUTSIDE = 3
    """Neither: outside the region."""
    EXCUSED = 4
    """Neither: on truth that needn't be found."""


@dataclass(frozen=True, eq=False)
class Judgement:
    """Partners and outcomes of the boxes of one class of one sequence."""

    counted: Counted
    truth_of_estimate: Int64
    """(M,) which of the N truth boxes was found; -1: none."""
    outcome: Array
    """(M,) int8 `Outcome`."""

    @property
    def counts(self) -> BoxCounts:
        """Sums over all steps."""
        num = np.bincount(self.outcome, minlength=len(Outcome)).tolist()
        tp, invalid = num[Outcome.HIT], num[Outcome.INVALID]
        predicted = self.counted.sequence.estimates.predicted
        return BoxCounts(
            tp=tp,
            fp=num[Outcome.FALSE_ALARM] + invalid,
            fn=len(self.counted.truth_row) - tp,
            ignored=num[Outcome.OUTSIDE] + num[Outcome.EXCUSED],
            invalid=invalid,
            invalid_truth=self.counted.sequence.num_invalid_truth,
            predicted=0 if predicted is None else self._num_counting(predicted[self.counted.estimate_row]),
        )

    def _num_counting(self, marked: Bool) -> int:
        """How many of the marked estimates (M,) are hits or false alarms."""
        return int(np.count_nonzero(marked & ~np.isin(self.outcome, (Outcome.OUTSIDE, Outcome.EXCUSED))))


def judge_detections(counted: Counted) -> Judgement:
    """Match greedily: of the estimates inside the region, then of the others, the best score chooses first."""
    partner = match_greedy(counted.similarity, counted.match.floor, counted.score, ~counted.inside)
    return judged(counted, partner)


def judge_ranked(counted: Counted) -> Judgement:
    """Match greedily by score alone, so that what is left at a higher threshold is matched as it would be there."""
    return judged(counted, match_greedy(counted.similarity, counted.match.floor, counted.score))


def judge_tracks(counted: Counted) -> Judgement:
    """Match each step for most pairs, then most estimates inside the region, then the best total."""
    return judged(counted, match_best(counted.similarity, counted.match.floor, ~counted.inside), by_score=False)


def judged(counted: Counted, partner: Int64, by_score: bool = True) -> Judgement:
    """An estimate without partner is a false alarm unless it is excused or outside the region.

    Args:
        counted: What was matched.
        partner: (M,) truth box of each estimate; -1: none.
        by_score: Whether the best score is excused first, as it is matched first; else as many as possible are.
    """
    free = partner < 0
    outcome = np.where(free, Outcome.FALSE_ALARM, Outcome.HIT).astype(np.int8)
    outcome[free & ~counted.inside] = Outcome.OUTSIDE
    candidates = free & counted.inside & ~counted.invalid
    if candidates.any():
        outcome[_excused(counted, candidates, by_score)] = Outcome.EXCUSED
    outcome[counted.invalid] = Outcome.INVALID
    return Judgement(counted, partner, outcome)


def _excused(counted: Counted, candidates: Array, by_score: bool) -> Array:
    """Which of the candidates (M,) lie on truth that needn't be found."""
    excuse = counted.excuse
    _rows, columns = excuse.pairs
    good = (excuse.values >= counted.match.floor) & candidates[columns]
    excused = np.zeros(len(candidates), bool)
    if counted.shared_excuse:
        excused[columns[good]] = True
        return excused
    single = replace(excuse, values=np.where(good, excuse.values, -np.inf))
    if by_score:
        return np.asarray(match_greedy(single, counted.match.floor, counted.score) >= 0)
    return np.asarray(match_best(single, counted.match.floor) >= 0)
