"""Outcomes of boxes: hit, miss, false alarm or ignored, and their counts."""

from dataclasses import asdict, dataclass, replace
from enum import IntEnum
from functools import cached_property

import numpy as np

from fbench.metrics.core.exact import Counts
from fbench.metrics.core.matching import match_best, match_greedy
from fbench.metrics.core.problem import is_valid
from fbench.metrics.core.similarity import Blocks, blocks, image_overlaps
from fbench.metrics.core.slices import Group, Part
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.arrays import Array, Bool, Int64
from fbench.replay.data.sequences import Objects, Sequence


@dataclass(frozen=True, eq=False)
class Candidates:
    """T truth boxes of a sequence and the M estimates of one class, and how alike they are."""

    sequence: Sequence
    match: Match
    must: Bool  # (T,) truth boxes to be found; the others may excuse estimates
    estimate_row: Int64  # (M,) rows of the sequence's estimates
    estimates: Objects  # The M estimates
    inside: Bool  # (M,) false for estimates outside the region: they can be hits but no false alarms
    invalid: Bool  # (M,) estimates that aren't finite, or have negative sizes
    all_similarity: Blocks  # (T, M), higher is nearer; -inf for invalid estimates
    all_shares: Blocks  # (T, M), as `all_similarity`, or the share of the estimate that is in the truth box
    excuses: tuple[Bool, Bool]
    """(T,) truth boxes that excuse any estimate where they needn't be found, (M,) estimates that any such box excuses.
    """

    @cached_property
    def truth_row(self) -> Int64:
        """(N,) rows of the truth boxes to be found."""
        return np.flatnonzero(self.must)

    @cached_property
    def truth(self) -> Objects:
        """The N truth boxes to be found."""
        return self.sequence.truth[self.truth_row]

    @cached_property
    def similarity(self) -> Blocks:
        """(N, M) of the truth boxes to be found."""
        return self.all_similarity.select(self.must, np.ones(len(self.estimate_row), bool))

    @cached_property
    def excuse(self) -> Blocks:
        """(K, M) shares of the other truth boxes; -inf where the box can't excuse the estimate."""
        shares = self.all_shares.select(~self.must, np.ones(len(self.estimate_row), bool))
        return shares.only(self.excuses[0][~self.must], self.excuses[1])

    def select(self, part: Part) -> "Candidates":
        """Return what counts of a part of the sequence."""
        rows, everything = self.estimate_row, np.ones(len(self.must), bool)
        given = part.estimates[rows] | ~self.invalid  # elsewhere, what isn't valid is nobody's false alarm
        if part.given is not None:
            given &= part.given[rows]
        return replace(
            self, must=self.must & part.truth, estimate_row=rows[given], estimates=self.estimates[given],
            inside=(self.inside & part.estimates[rows])[given], invalid=self.invalid[given],
            all_similarity=self.all_similarity.select(everything, given),
            all_shares=self.all_shares.select(everything, given),
            excuses=(self.excuses[0], self.excuses[1][given]),
        )  # fmt: skip


def compare_class(sequence: Sequence, group: Group, match: Match) -> Candidates:
    """Compare all truth with the estimates of one class.

    In space a truth box that needn't be found excuses one estimate that matches it. In images it excuses all estimates
    that lie in it with at least the match's share, as KITTI does for its regions: they are larger than what is in them,
    and hold any number of objects. Raises MetricError where boxes lack what the match compares.
    """
    truth, estimate_row = sequence.truth, np.flatnonzero(group.holds(sequence.estimates))
    estimates = sequence.estimates[estimate_row]
    invalid = ~is_valid(estimates, match.kind)
    pairs = blocks(truth, estimates, len(sequence.steps), match.kind, sequence.ego_m)
    shares = pairs
    if match.kind == "iou2d":
        shares = image_overlaps(truth, estimates, len(sequence.steps), np.ones(len(truth), bool))
    return Candidates(
        sequence, match, group.counts(truth), estimate_row, estimates,
        np.ones(len(estimates), bool) if estimates.inside is None else estimates.inside, invalid,
        pairs.only(np.zeros(len(truth), bool), ~invalid), shares,
        group.excuses(truth, estimates),
    )  # fmt: skip


@dataclass(frozen=True)
class BoxCounts(Counts):
    """Hits and misses."""

    tp: int = 0
    fp: int = 0
    fn: int = 0
    ignored: int = 0  # Estimates that are neither: outside the region, or on truth that needn't be found
    invalid: int = 0  # Estimates that aren't finite; they are in `fp` too
    invalid_truth: int = 0  # Truth boxes that aren't finite; they are left out
    predicted: int = 0  # Estimates that counted though nothing measured them: predictions of a tracker

    @property
    def gt(self) -> int:
        """Truth boxes that had to be found."""
        return self.tp + self.fn

    @property
    def estimates(self) -> int:
        """Estimates that counted."""
        return self.tp + self.fp

    def as_dict(self) -> dict[str, int]:
        """All counts by name but that of predictions."""
        return {name: num for name, num in asdict(self).items() if name != "predicted"}


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

    candidates: Candidates
    truth_of_estimate: Int64  # (M,) which of the N truth boxes was found; -1: none
    outcome: Array  # (M,) int8 `Outcome`

    @property
    def is_used(self) -> Bool:
        """(M,) hits and false alarms."""
        return ~np.isin(self.outcome, (Outcome.OUTSIDE, Outcome.EXCUSED))

    @property
    def counts(self) -> BoxCounts:
        """Sums over all steps."""
        num = np.bincount(self.outcome, minlength=len(Outcome)).tolist()
        tp, invalid = num[Outcome.HIT], num[Outcome.INVALID]
        sequence, predicted = self.candidates.sequence, self.candidates.estimates.predicted
        return BoxCounts(
            tp=tp,
            fp=num[Outcome.FALSE_ALARM] + invalid,
            fn=len(self.candidates.truth_row) - tp,
            ignored=num[Outcome.OUTSIDE] + num[Outcome.EXCUSED],
            invalid=invalid,
            invalid_truth=sequence.num_invalid_truth,
            predicted=0 if predicted is None else int(np.count_nonzero(predicted & self.is_used)),
        )


def judge_detections(candidates: Candidates) -> Judgement:
    """Match greedily: of the estimates inside the region, then of the others, the best score chooses first."""
    c = candidates
    return judge(c, match_greedy(c.similarity, c.match.floor, c.estimates.score, ~c.inside))


def judge_ranked(candidates: Candidates) -> Judgement:
    """Match greedily by score alone, so that what is left at a higher threshold is matched as it would be there."""
    c = candidates
    return judge(c, match_greedy(c.similarity, c.match.floor, c.estimates.score))


def judge(candidates: Candidates, partner: Int64, by_score: bool = True) -> Judgement:
    """Judge estimates by the truth box (M,) that each is matched with; without one (-1) it is a false alarm, unless it
    is excused or outside the region. `by_score`: the best score is excused first, as it is matched first; else as many
    as possible are.
    """
    c, free = candidates, partner < 0
    outcome = np.where(free, Outcome.FALSE_ALARM, Outcome.HIT).astype(np.int8)
    outcome[free & ~c.inside] = Outcome.OUTSIDE
    excusable = free & c.inside & ~c.invalid
    if excusable.any():
        if c.match.kind == "iou2d":  # one box can excuse several estimates
            columns = c.excuse.locate(np.flatnonzero(c.excuse.values >= c.match.floor))[1]
            outcome[columns[excusable[columns]]] = Outcome.EXCUSED
        else:
            single = c.excuse.only(np.zeros(c.excuse.shape[0], bool), excusable)
            floor, score = c.match.floor, c.estimates.score
            found = match_greedy(single, floor, score) if by_score else match_best(single, floor)
            outcome[found >= 0] = Outcome.EXCUSED
    outcome[c.invalid] = Outcome.INVALID
    return Judgement(c, partner, outcome)
