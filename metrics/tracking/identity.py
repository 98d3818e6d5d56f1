"""Identity (Ristani et al. 2016): one estimated track for each truth track, over all steps."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.core.exact import Counts
from fbench.metrics.core.problem import Problem
from fbench.metrics.core.similarity import block_starts
from fbench.replay.data.arrays import Bool, Int64


def near_pairs(problem: Problem, place: Int64) -> tuple[Int64, Int64]:
    """Return the pairs of tracks (P,) that have boxes at these places (K,) of the similarities, as truth id times
    (number of estimate ids) plus estimate id; and which of them each place belongs to (K,).
    """
    truth, estimate = problem.pairs.locate(place)
    keys = problem.truth_id[truth] * problem.num_estimate_ids + problem.estimate_id[estimate]
    return np.unique(keys, return_inverse=True)


@dataclass(frozen=True)
class IdentityCounts(Counts):
    """Sufficient statistics of IDF1, IDP and IDR: boxes under the right identity, and the others."""

    tp: int = 0
    fn: int = 0
    fp: int = 0


def identity_counts(problem: Problem, floor: float) -> IdentityCounts:
    """Pair tracks one to one such that false positives and misses together are the fewest.

    Two boxes need a similarity of `floor` to count as the same.
    """
    num_truth, num_estimates = problem.pairs.shape
    tp = len(find_identified(problem, floor))
    return IdentityCounts(tp, num_truth - tp, num_estimates - tp)


def find_identified(problem: Problem, floor: float) -> Int64:
    """Return the truth boxes (K,), ascending, that have a box of their own track's one partner near them."""
    place = np.flatnonzero(problem.pairs.values >= floor)
    track_pair, pair_of = near_pairs(problem, place)
    if not len(track_pair):
        return np.zeros(0, np.int64)
    is_best = _best(*np.divmod(track_pair, problem.num_estimate_ids), np.bincount(pair_of))
    return np.sort(problem.pairs.locate(place[is_best[pair_of]])[0])


def _best(row: Int64, column: Int64, weight: Int64) -> Bool:
    """Which one-to-one pairs (P,) weigh most: each common box saves a false positive and a miss.

    Tracks that have nothing to do with each other, also by way of others, are solved apart, as steps are elsewhere.
    """
    from fbench.metrics.core.assignment_kernel import best_places  # numba takes a while to import
    from fbench.metrics.tracking.kernels import link_groups

    num_rows = int(row.max()) + 1
    group = link_groups(row, num_rows + column, np.arange(num_rows + int(column.max()) + 1))
    (row_start, i), (column_start, j) = _within(row, group), _within(column, group)
    width = np.diff(column_start)
    block_start = block_starts(row_start, column_start)
    score = np.zeros(block_start[-1])
    own = block_start[group] + i * width[group] + j
    score[own] = weight
    place = best_places(row_start, column_start, block_start, score, 0.0, 0.0)
    return np.isin(own, place[place >= 0])


def _within(name: Int64, group: Int64) -> tuple[Int64, Int64]:
    """Offsets (G + 1,) of groups in the distinct names of pairs, and the place (P,) of each name in its group."""
    own = np.full(int(name.max()) + 1, -1)  # -1: names of no pair
    own[name] = group
    place = np.empty(len(own), np.int64)
    place[np.argsort(own, kind="stable")] = np.arange(len(own))
    start = np.cumsum(np.bincount(own + 1))
    return start - start[0], place[name] - start[group]
