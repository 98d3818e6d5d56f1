"""What CLEAR counts for each score from which on results are taken."""

from typing import NamedTuple

import numpy as np

from fbench.metrics.kernels.assignment import assign
from fbench.replay.arrays import Array, Bool, Float64
from fbench.replay.kernels import kernel


class Candidates(NamedTuple):
    """Boxes of one class of one sequence, by step, and the pairs of them that are near; int32 but for the reals."""

    truth_start: Array
    """(S + 1,) offsets of steps."""
    truth_track: Array
    """(N,)"""
    estimate_start: Array
    """(S + 1,)"""
    estimate_track: Array
    """(M,)"""
    score: Array
    """(M,)"""
    pair_start: Array
    """(N + 1,) offsets of the pairs of each truth box."""
    pair_estimate: Array
    """(P,) rows."""
    pair_m: Array
    """(P,) distances."""


TP, IDS, FP, FN, FRAMES, MT, ML, FRAG, FOUND, LATE, GAP = range(11)
"""Columns of counts: matches without switches, switches, false positives, misses, samples with any box; tracks
matched in at least 80 % of their samples, in less than 20 %; returns to unmatched between matches; tracks ever matched,
and summed over these the samples before the first match and the samples of the longest gap."""
COUNTS = ("tp", "ids", "fp", "fn", "frames", "mt", "ml", "frag", "found", "late", "gap")
"""Their names."""
_BOXES, _MATCHES, _FIRST, _FIRST_MATCH, _NEXT, _GAP, _LONGEST, _MISSES, _BREAKS = range(9)
"""What is known of a truth track: number of boxes and of matches, frame of the first of each, frame after the last box,
length of the gap that it is in and of its longest, misses since the last match, times it was lost between matches."""


@kernel
def near_pairs(
    truth_xy: Float64, truth_start: Array, estimate_xy: Float64, estimate_start: Array, invalid: Bool, limit_m: float
) -> tuple[Array, Array, Float64]:
    """Return offsets (N + 1,) of the pairs of each truth box, their estimates (P,) and distances (P,) below a limit."""
    pair_start = np.zeros(len(truth_xy) + 1, np.int32)
    estimates, distances_m = np.empty(0, np.int32), np.empty(0)
    for is_filling in (False, True):
        num = 0
        for step in range(len(truth_start) - 1):
            for t in range(truth_start[step], truth_start[step + 1]):
                for e in range(estimate_start[step], estimate_start[step + 1]):
                    dx, dy = estimate_xy[e, 0] - truth_xy[t, 0], estimate_xy[e, 1] - truth_xy[t, 1]
                    distance_m = np.sqrt(dx * dx + dy * dy)
                    if distance_m < limit_m and not invalid[e]:
                        if is_filling:
                            estimates[num], distances_m[num] = e, distance_m
                        num += 1
                pair_start[t + 1] = num
        if not is_filling:
            estimates, distances_m = np.empty(num, np.int32), np.empty(num)
    return pair_start, estimates, distances_m


@kernel
def sweep(thresholds: Float64, near: Candidates, num_tracks: int) -> tuple[Array, Float64, Bool]:
    """Count (T, 11) and sum up the distances of pairs (T,) [m], with results from each threshold (T,) on.

    Also returns which estimates (M,) match without a switch at the last threshold.
    """
    counts = np.zeros((len(thresholds), len(COUNTS)), np.int64)
    total_m = np.zeros(len(thresholds))
    continued = np.zeros(len(near.score), np.bool_)
    for i in range(len(thresholds)):
        continued[:] = False
        total_m[i] = _count(thresholds[i], near, num_tracks, counts[i], continued)
    return counts, total_m, continued


@kernel
def _count(threshold: float, near: Candidates, num_tracks: int, counts: Array, continued: Bool) -> float:
    last = np.full(num_tracks, -1, np.int64)
    history = np.zeros((num_tracks, 9), np.int64)
    taken, column = near.score < threshold, np.zeros(len(near.score), np.int64)
    partner, distance_m = np.full(len(near.truth_track), -1, np.int64), np.zeros(len(near.truth_track))
    for step in range(len(near.truth_start) - 1):
        first, end = near.truth_start[step], near.truth_start[step + 1]
        num_estimates = 0
        for e in range(near.estimate_start[step], near.estimate_start[step + 1]):
            num_estimates += not taken[e]
        if first == end and num_estimates == 0:
            continue
        _go_on(first, end, near, last, taken, partner, distance_m)
        _pair_up(first, end, near, taken, partner, distance_m, column)
        counts[FP] += num_estimates
        for t in range(first, end):
            track = near.truth_track[t]
            _remember(history[track], counts[FRAMES], partner[t] >= 0)
            if partner[t] < 0:
                counts[FN] += 1
                continue
            estimate_track = near.estimate_track[partner[t]]
            switched = last[track] >= 0 and last[track] != estimate_track
            counts[IDS if switched else TP] += 1
            counts[FP] -= 1
            continued[partner[t]] = not switched
            last[track] = estimate_track
        counts[FRAMES] += 1
    for track in range(num_tracks):
        _count_track(history[track], counts)
    total_m: float = distance_m.sum()
    return total_m


@kernel
def _go_on(first: int, end: int, near: Candidates, last: Array, taken: Bool, partner: Array, metres: Array) -> None:
    """Pair truth of one step with the track that it had last, if that is near and free, in the order of truth rows."""
    for t in range(first, end):
        for p in range(near.pair_start[t], near.pair_start[t + 1]):
            e = near.pair_estimate[p]
            if not taken[e] and near.estimate_track[e] == last[near.truth_track[t]]:
                partner[t], metres[t], taken[e] = e, near.pair_m[p], True
                break


@kernel
def _pair_up(
    first: int, end: int, near: Candidates, taken: Bool, partner: Array, metres: Array, column: Array
) -> None:  # fmt: skip
    """Make as many pairs as possible of what is left of one step, among these with the least sum of distances.

    `column` (M,) is 0 at the beginning and at the end.
    """
    n, m, total_m = _number_columns(first, end, near, taken, partner, column)
    if m == 0:
        return
    limit = 2.0 * total_m + 1.0  # more than all pairs together
    cost, name = np.full((n, m), limit), np.empty(m, np.int64)
    _fill_costs(first, end, near, taken, partner, column, cost, name)
    column_of = assign(cost)
    i = 0
    for t in range(first, end):
        if partner[t] < 0:
            j = column_of[i]
            if j >= 0 and cost[i, j] < limit:
                partner[t], metres[t], taken[name[j]] = name[j], cost[i, j], True
            i += 1
    for j in range(m):
        column[name[j]] = 0


@kernel
def _number_columns(
    first: int, end: int, near: Candidates, taken: Bool, partner: Array, column: Array
) -> tuple[int, int, float]:  # fmt: skip
    """Number free estimates near free truth from 1; returns how many truth boxes and estimates, and all metres."""
    n, m, total_m = 0, 0, 0.0
    for t in range(first, end):
        if partner[t] < 0:
            n += 1
            for p in range(near.pair_start[t], near.pair_start[t + 1]):
                e = near.pair_estimate[p]
                if not taken[e]:
                    total_m += near.pair_m[p]
                    if column[e] == 0:
                        m += 1
                        column[e] = m
    return n, m, total_m


@kernel
def _fill_costs(
    first: int, end: int, near: Candidates, taken: Bool, partner: Array, column: Array, cost: Float64, name: Array
) -> None:  # fmt: skip
    """Write distances into costs (n, m), and which estimate (m,) is in which column."""
    i = 0
    for t in range(first, end):
        if partner[t] < 0:
            for p in range(near.pair_start[t], near.pair_start[t + 1]):
                e = near.pair_estimate[p]
                if not taken[e]:
                    cost[i, column[e] - 1], name[column[e] - 1] = near.pair_m[p], e
            i += 1


@kernel
def _remember(track: Array, frame: int, matched: bool) -> None:
    """Bring what is known of a truth track up to date; `frame` counts samples with any box of the class."""
    if track[_BOXES] == 0:
        track[_FIRST], track[_NEXT] = frame, frame
    track[_GAP] += frame - track[_NEXT]
    if matched:
        if track[_MATCHES] == 0:
            track[_FIRST_MATCH] = frame
        else:
            track[_BREAKS] += track[_MISSES] > 0
        track[_LONGEST] = max(track[_LONGEST], track[_GAP])
        track[_GAP], track[_MISSES] = 0, 0
        track[_MATCHES] += 1
    else:
        track[_GAP] += 1
        track[_MISSES] += 1
    track[_BOXES] += 1
    track[_NEXT] = frame + 1


@kernel
def _count_track(track: Array, counts: Array) -> None:
    if track[_BOXES] == 0:
        return
    share = track[_MATCHES] / track[_BOXES]
    counts[MT] += share >= 0.8
    counts[ML] += share < 0.2
    counts[FRAG] += track[_BREAKS]
    if track[_MATCHES] > 0:
        counts[FOUND] += 1
        counts[LATE] += track[_FIRST_MATCH] - track[_FIRST]
        counts[GAP] += max(track[_LONGEST], track[_GAP])
