"""CLEAR MOT (Bernardin and Stiefelhagen 2008): matches that go on from step to step."""

from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

import numpy as np

from fbench.metrics.core.exact import Counts, exact_sum
from fbench.metrics.core.problem import Problem
from fbench.metrics.tracking.clear_events import ASCEND, MIGRATE, START, SWITCH, TRANSFER
from fbench.replay.data.arrays import Int64


@dataclass(frozen=True)
class ClearRules:
    """What differs between those who count CLEAR; the defaults are TrackEval 1.3.0's."""

    floor: float = 0.5  # Similarity from which on boxes can match; distances are negated
    margin: float = float(np.finfo(float).eps)  # How far below the floor they still can
    offset: float = 0.0
    """Added to similarities before the best sum is looked for: how much any pair is worth. Distances need one."""
    memory: Literal["previous step", "last match"] = "previous step"
    """Which pairs go on before others: those of the previous step that had truth and estimates, or those of each truth
    track's last match, whatever the gap."""
    settle_first: bool = False
    """Remembered pairs are made before all others; else they count 1000 more in one common assignment."""
    most_pairs: bool = False  # As many pairs as possible, and of those the best sum; else the best sum
    own_frames: bool = False
    """Fragmentations are misses of a truth box between matches; else also frames in which the truth track isn't
    there, but not those without any estimate."""
    tracked_share: float = 0.8
    tracked_inclusive: bool = False  # Mostly tracked: matched in the `tracked_share` of its boxes or more; else in more
    lost_share: float = 0.2  # Mostly lost: matched in less than this share of its boxes
    counts_one_sided: bool = False  # Steps are counted also of sequences without any truth or without any estimate


TRACKEVAL_RULES = ClearRules()


@dataclass(frozen=True, eq=False)
class ClearPairs:
    """Partners of all N truth boxes and M estimates of a problem, as rows of the problem; -1 where there is none."""

    estimate_of: Int64  # (N,)
    truth_of: Int64  # (M,)
    event: Int64  # (N,) bits of `fbench.metrics.tracking.clear_events`; 0 for misses

    def count(self, event: int) -> int:
        """How many matches are an event."""
        return int(np.count_nonzero(self.event & event))


@dataclass(frozen=True)
class ClearCounts(Counts):
    """Sufficient statistics of CLEAR."""

    tp: int = 0
    fn: int = 0
    fp: int = 0
    switches: int = 0
    fragmentations: int = 0
    mostly_tracked: int = 0
    partly_tracked: int = 0
    mostly_lost: int = 0
    num_steps: int = 0
    transfers: int = 0
    ascends: int = 0
    migrations: int = 0
    similarity: Fraction = Fraction(0)  # Sum over matches; distances are negated

    @property
    def num_truth(self) -> int:
        """Truth boxes."""
        return self.tp + self.fn

    @property
    def num_tracks(self) -> int:
        """Truth tracks."""
        return self.mostly_tracked + self.partly_tracked + self.mostly_lost


def clear_pairs(problem: Problem, rules: ClearRules) -> ClearPairs:
    """Match truth and estimates step by step."""
    from fbench.metrics.tracking.kernels import MEMORY, follow  # numba takes a while to import

    p, pairs, (num_truth, num_estimates) = problem, problem.pairs, problem.pairs.shape
    estimate_of, truth_of = np.full(num_truth, -1), np.full(num_estimates, -1)
    event = np.zeros(num_truth, np.int64)
    if num_truth and num_estimates:
        tracks, others = np.full((p.num_truth_ids, MEMORY), -1), np.full((p.num_estimate_ids, MEMORY), -1)
        follow(
            pairs.row_start, pairs.column_start, pairs.start, pairs.values, p.stream, p.truth_id, p.estimate_id,
            rules.floor - rules.margin, rules.offset, rules.memory == "last match", rules.settle_first,
            rules.most_pairs, rules.own_frames, tracks, others, np.full(int(p.stream.max()) + 1, -1), estimate_of,
            event,
        )  # fmt: skip
        rows = np.flatnonzero(estimate_of >= 0)
        truth_of[estimate_of[rows]] = rows
    return ClearPairs(estimate_of, truth_of, event)


def clear_counts(problem: Problem, rules: ClearRules, made: ClearPairs | None = None) -> ClearCounts:
    """Count what `clear_pairs` has matched."""
    made = made or clear_pairs(problem, rules)
    rows, pairs = np.flatnonzero(made.estimate_of >= 0), problem.pairs
    tp, (num_truth, num_estimates) = len(rows), pairs.shape
    is_whole = rules.counts_one_sided or (num_truth > 0 and num_estimates > 0)
    size = np.bincount(problem.truth_id, minlength=problem.num_truth_ids)
    share = np.bincount(problem.truth_id[rows], minlength=len(size)) / size
    is_tracked = share >= rules.tracked_share if rules.tracked_inclusive else share > rules.tracked_share
    tracked, lost = int(is_tracked.sum()), int((share < rules.lost_share).sum())
    step = np.searchsorted(pairs.row_start, rows, side="right") - 1
    width = pairs.column_start[step + 1] - pairs.column_start[step]
    i, j = rows - pairs.row_start[step], made.estimate_of[rows] - pairs.column_start[step]
    return ClearCounts(
        tp=tp,
        fn=num_truth - tp,
        fp=num_estimates - tp,
        switches=made.count(SWITCH),
        fragmentations=made.count(START) - len(np.unique(problem.truth_id[rows])),
        mostly_tracked=tracked,
        partly_tracked=len(size) - tracked - lost,
        mostly_lost=lost,
        num_steps=len(problem.stream) if is_whole else 0,
        transfers=made.count(TRANSFER),
        ascends=made.count(ASCEND),
        migrations=made.count(MIGRATE),
        similarity=exact_sum(pairs.values[pairs.start[step] + i * width + j]),
    )
