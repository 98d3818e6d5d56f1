"""Pairs of boxes that are near each other, out of all of a problem."""

from dataclasses import dataclass

import numpy as np

from fbench.metrics.problem import Problem
from fbench.replay.arrays import Bool, Int64


@dataclass(frozen=True, eq=False)
class NearPairs:
    """K pairs of a truth row and an estimate row of the same step, in the order of the problem's similarities."""

    place: Int64
    """(K,) in the problem's similarities."""
    truth: Int64
    """(K,)"""
    estimate: Int64
    """(K,)"""
    track_pair: Int64
    """(P,) pairs of tracks that are near anywhere, as truth id times (number of estimate ids) plus estimate id."""
    track_pair_of: Int64
    """(K,) which of these each pair belongs to."""


def near_pairs(problem: Problem, is_near: Bool) -> NearPairs:
    """Return the pairs that are marked in (B,)."""
    place = np.flatnonzero(is_near)
    step = np.searchsorted(problem.block_start, place, side="right") - 1
    row, column = np.divmod(place - problem.block_start[step], np.diff(problem.estimate_start)[step])
    truth, estimate = problem.truth_start[step] + row, problem.estimate_start[step] + column
    keys = problem.truth_id[truth] * problem.num_estimate_ids + problem.estimate_id[estimate]
    return NearPairs(place, truth, estimate, *np.unique(keys, return_inverse=True))
