"""Outcomes of boxes: hit, miss, false alarm or ignored, and their counts."""

from dataclasses import asdict, dataclass, replace
from enum import IntEnum
from functools import cached_property

import numpy as np

from fbench.metrics.core.matching import match_best, match_greedy
from fbench.metrics.core.problem import is_valid
from fbench.metrics.core.sequence import Objects, Sequence
from fbench.metrics.core.similarity import Blocks, blocks, image_overlaps, pairs_of
from fbench.metrics.core.slices import Group, Part
from fbench.metrics.profiles.profile import Match
from fbench.replay.data.arrays import Array, Bool, Float64, Int64


@dataclass(frozen=True, eq=False)
class Alike:
    """T truth boxes of a sequence and the M estimates of one class, and how alike they are."""

    sequence: Sequence
    must: Bool  # (T,) truth boxes to be found; the others may excuse estimates
    estimate_row: Int64  # (M,) rows of the sequence's estimates
    similarity: Blocks  # (T, M), higher is nearer; -inf for invalid estimates
    excuse: Blocks
    """(T, M), as `similarity`, or the share of the estimate that is in the truth box; -inf where the box couldn't
    excuse the estimate if it needn't be found."""
    match: Match
    invalid: Bool  # (M,) estimates that aren't finite, or have negative sizes


@dataclass(frozen=True, eq=False)
class Counted:
    """One class of a sequence, or of a part of it: N truth boxes to be found, M estimates, K truth boxes that may
    excuse estimates.
    """

    sequence: Sequence
    truth_row: Int64  # (N,) rows of the sequence's truth
    rest_row: Int64  # (K,) its other rows
    estimate_row: Int64  # (M,) rows of the sequence's estimates
    similarity: Blocks  # (N, M), higher is nearer; -inf for invalid estimates
    excuse: Blocks  # (K, M), as `similarity`; -inf where the box doesn't excuse the estimate
    match: Match
    inside: Bool  # (M,) false for estimates outside the region: they can be hits but no false alarms
    invalid: Bool  # (M,) estimates that aren't finite, or have negative sizes

    @cached_property
    def truth(self) -> Objects:
        """The N truth boxes."""
        return self.sequence.truth[self.truth_row]

    @cached_property
    def estimates(self) -> Objects:
        """The M estimates."""
        return self.sequence.estimates[self.estimate_row]

    @property
    def score(self) -> Float64:
        """(M,) of the estimates."""
        return self.sequence.estimates.score[self.estimate_row]

    @property
    def shared_excuse(self) -> bool:
        """Whether one box can excuse several estimates."""
        return self.match.likeness == "iou2d"


def alike(sequence: Sequence, group: Group, match: Match) -> Alike:
    """Compare all truth with the estimates of one class.

    In space a truth box that needn't be found excuses one estimate that matches it. In images it excuses all estimates
    that lie in it with at least the match's share, as KITTI does for its regions: they are larger than what is in them,
    and hold any number of objects. Raises MetricError where boxes lack what the match compares.
    """
    truth, estimate_row = sequence.truth, np.flatnonzero(group.holds(sequence.estimates))
    estimates = sequence.estimates[estimate_row]
    starts = [objects.starts(len(sequence.steps)) for objects in (truth, estimates)]
    invalid = ~is_valid(estimates, match.likeness)
    values, start = blocks(truth, estimates, starts[0], starts[1], match.likeness, sequence.ego_m)
    pairs = pairs_of(starts[0], starts[1])
    if match.likeness == "iou2d":
        shares, _ = image_overlaps(truth, estimates, starts[0], starts[1], np.ones(len(truth), bool))
    else:
        shares = values
    usable = ~invalid[pairs[1]]
    excused = usable & group.excuses(truth, estimates, pairs)
    similarity, excuse = (
        Blocks(starts[0], starts[1], start, np.where(held, numbers, -np.inf))
        for held, numbers in ((usable, values), (excused, shares))
    )
    return Alike(sequence, group.counts(truth), estimate_row, similarity, excuse, match, invalid)


def counted(pairs: Alike, part: Part | None = None) -> Counted:
    """Select what counts: of the whole sequence, or of a part of it."""
    rows, num = pairs.estimate_row, len(pairs.estimate_row)
    estimates = pairs.sequence.estimates
    inside = np.ones(num, bool) if estimates.inside is None else estimates.inside[rows]
    must, given = pairs.must, np.ones(num, bool)
    if part is not None:
        must, inside = must & part.truth, inside & part.estimates[rows]
        given = part.estimates[rows] | ~pairs.invalid  # elsewhere, what isn't valid is nobody's false alarm
        given = given if part.given is None else given & part.given[rows]
    return Counted(
        pairs.sequence, np.flatnonzero(must), np.flatnonzero(~must), rows[given], pairs.similarity.select(must, given),
        pairs.excuse.select(~must, given), pairs.match, inside[given], pairs.invalid[given],
    )  # fmt: skip


@dataclass(frozen=True)
class BoxCounts:
    """Hits and misses."""

    tp: int = 0
    fp: int = 0
    fn: int = 0
    ignored: int = 0  # Estimates that are neither: outside the region, or on truth that needn't be found
    invalid: int = 0  # Estimates that aren't finite; they are in `fp` too
    invalid_truth: int = 0  # Truth boxes that aren't finite; they are left out
    predicted: int = 0  # Estimates that counted though nothing measured them: predictions of a tracker

    def __add__(self, other: "BoxCounts") -> "BoxCounts":
        return BoxCounts(
            self.tp + other.tp, self.fp + other.fp, self.fn + other.fn, self.ignored + other.ignored,
            self.invalid + other.invalid, self.invalid_truth + other.invalid_truth, self.predicted + other.predicted,
        )  # fmt: skip

    @property
    def gt(self) -> int:
        """Truth boxes that had to be found."""
        return self.tp + self.fn

    @property
    def estimates(self) -> int:
        """Estimates that counted."""
        return self.tp + self.fp

    def named(self, with_predicted: bool) -> dict[str, int]:
        """All counts by name; that of predictions only if it is wanted, and isn't 0."""
        counts = asdict(self)
        if not (with_predicted and self.predicted):
            del counts["predicted"]
        return counts


class Outcome(IntEnum):
    """Of an estimate."""

    HIT = 0
    FALSE_ALARM = 1
    INVALID = 2  # A false alarm because it isn't finite, or has a negative size
    OUTSIDE = 3  # Neither: outside the region
    EXCUSED = 4  # Neither: on truth that needn't be found


@dataclass(frozen=True, eq=False)
class Judgement:
    """Partners and outcomes of the boxes of one class of one sequence."""

    counted: Counted
    truth_of_estimate: Int64  # (M,) which of the N truth boxes was found; -1: none
    outcome: Array  # (M,) int8 `Outcome`

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
