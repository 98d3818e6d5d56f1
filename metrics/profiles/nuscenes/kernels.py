"""Compiled matching of the nuScenes benchmarks."""

import math

import numpy as np

from fbench.metrics.core.assignment_kernel import assign
from fbench.metrics.profiles.nuscenes.boxes import NearBoxes
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.geometry.kernels import kernel, kernel_part


@kernel
def match_nearest(
    truth_xy: Float64, truth_start: Int64, estimate_xy: Float64, estimate_start: Int64, invalid: Bool, limits_m: Float64
) -> Array:
    """Return the truth row (M, D) of each estimate at each of the D limits below which pairs match, -1: there is none.

    Centers (N, 2) and (M, 2) [m] are sorted by group, one class of one sample, with offsets (G + 1,), and estimates in
    it best score first; the first of equally near truth boxes wins. Estimates that are `invalid` (M,) match nothing.
    """
    partner, taken = np.empty((len(estimate_xy), len(limits_m)), np.int64), np.empty(len(truth_xy), np.bool_)
    for d in range(len(limits_m)):
        for t in range(len(taken)):
            taken[t] = False
        for group in range(len(truth_start) - 1):
            for e in range(estimate_start[group], estimate_start[group + 1]):
                partner[e, d] = -1
                if invalid[e]:
                    continue
                nearest, best_m = -1, limits_m[d]
                for t in range(truth_start[group], truth_start[group + 1]):
                    if taken[t]:
                        continue
                    dx, dy = estimate_xy[e, 0] - truth_xy[t, 0], estimate_xy[e, 1] - truth_xy[t, 1]
                    distance_m = math.sqrt(dx * dx + dy * dy)
                    if distance_m < best_m:
                        nearest, best_m = t, distance_m
                if nearest >= 0:
                    taken[nearest] = True
                    partner[e, d] = nearest
    return partner


TP, IDS, FP, FN, FRAMES, MT, ML, FRAG, FOUND, LATE, GAP = range(11)
"""Columns of counts: matches without switches, switches, false positives, misses, samples with any box; tracks
matched in at least 80 % of their samples, in less than 20 %; returns to unmatched between matches; tracks ever matched,
and summed over these the samples before the first match and the samples of the longest gap."""
COUNTS = ("tp", "ids", "fp", "fn", "frames", "mt", "ml", "frag", "found", "late", "gap")  # Their names
NUM_COUNTS = 11
_NUM_KNOWN = 9
_BOXES, _MATCHES, _FIRST, _FIRST_MATCH, _NEXT, _GAP, _LONGEST, _MISSES, _BREAKS = range(9)
"""What is known of a truth track: number of boxes and of matches, frame of the first of each, frame after the last box,
length of the gap that it is in and of its longest, misses since the last match, times it was lost between matches."""


@kernel
def near_pairs(
    truth_xy: Float64, truth_start: Array, estimate_xy: Float64, estimate_start: Array, invalid: Bool, limit_m: float
) -> tuple[Array, Array, Float64]:
    """Return offsets (N + 1,) of the pairs of each truth box, their estimates (P,) and distances (P,) below a limit."""
    pair_start = np.empty(len(truth_xy) + 1, np.int32)
    pair_start[0] = 0
    estimates, distances_m = np.empty(0, np.int32), np.empty(0)
    for is_filling in (False, True):
        num = 0
        for step in range(len(truth_start) - 1):
            for t in range(truth_start[step], truth_start[step + 1]):
                for e in range(estimate_start[step], estimate_start[step + 1]):
                    dx, dy = estimate_xy[e, 0] - truth_xy[t, 0], estimate_xy[e, 1] - truth_xy[t, 1]
                    distance_m = math.sqrt(dx * dx + dy * dy)
                    if distance_m < limit_m and not invalid[e]:
                        if is_filling:
                            estimates[num], distances_m[num] = e, distance_m
                        num += 1
                pair_start[t + 1] = num
        if not is_filling:
            estimates, distances_m = np.empty(num, np.int32), np.empty(num)
    return pair_start, estimates, distances_m


@kernel
def sweep(  # noqa: C901  # apart it compiles twice as long
    thresholds: Float64, near: NearBoxes, num_tracks: int
) -> tuple[Array, Float64, Bool]:
    """Count (T, 11) and sum up the distances of pairs (T,) [m], with results from each threshold (T,) on.

    Also returns which estimates (M,) match without a switch at the last threshold.
    """
    truth_start, truth_track, estimate_start = near.truth_start, near.truth_track, near.estimate_start
    num_truth, num_estimates, score = len(truth_track), len(near.score), near.score
    counts, total_m = np.empty((len(thresholds), NUM_COUNTS), np.int64), np.empty(len(thresholds))
    last, history = np.empty(num_tracks, np.int64), np.empty((num_tracks, _NUM_KNOWN), np.int64)
    taken, continued = np.empty(num_estimates, np.bool_), np.empty(num_estimates, np.bool_)
    column, partner, distance_m = np.empty(num_estimates, np.int64), np.empty(num_truth, np.int64), np.empty(num_truth)
    for e in range(num_estimates):
        column[e], continued[e] = 0, False
    for i in range(len(thresholds)):
        for c in range(NUM_COUNTS):
            counts[i, c] = 0
        for track in range(num_tracks):
            last[track] = -1
            for c in range(_NUM_KNOWN):
                history[track, c] = 0
        for e in range(num_estimates):
            taken[e], continued[e] = score[e] < thresholds[i], False
        for step in range(len(truth_start) - 1):
            first, end = truth_start[step], truth_start[step + 1]
            num = 0
            for e in range(estimate_start[step], estimate_start[step + 1]):
                num += 0 if taken[e] else 1
            if first == end and num == 0:
                continue
            _match_step(first, end, near, last, taken, partner, distance_m, column)
            counts[i, FP] += num
            for t in range(first, end):
                track, e = truth_track[t], partner[t]
                _remember(history, track, counts[i, FRAMES], e >= 0)
                if e < 0:
                    counts[i, FN] += 1
                    continue
                is_switch = last[track] >= 0 and last[track] != near.estimate_track[e]
                counts[i, IDS if is_switch else TP] += 1
                counts[i, FP] -= 1
                continued[e] = not is_switch
                last[track] = near.estimate_track[e]
            counts[i, FRAMES] += 1
        for track in range(num_tracks):
            _count_track(history, track, counts, i)
        total = 0.0
        for t in range(num_truth):
            total += distance_m[t]
        total_m[i] = total
    return counts, total_m, continued


@kernel_part
def _match_step(  # noqa: C901  # apart it compiles twice as long
    first: int, end: int, near: NearBoxes, last: Array, taken: Bool, partner: Array, meters: Array, column: Array
) -> None:
    """Pair truth of one step with the track that it had last, if that is near and free, in the order of truth rows.

    Then make as many pairs as possible of what is left, among these with the least sum of distances.
    `column` (M,) is 0 at the beginning and at the end; where free estimates are near free truth it numbers them from 1.
    """
    pair_start, pair_estimate, pair_m = near.pair_start, near.pair_estimate, near.pair_m
    for t in range(first, end):
        partner[t], meters[t] = -1, 0.0
        for p in range(pair_start[t], pair_start[t + 1]):
            e = pair_estimate[p]
            if not taken[e] and near.estimate_track[e] == last[near.truth_track[t]]:
                partner[t], meters[t], taken[e] = e, pair_m[p], True
                break
    n, m, total_m = 0, 0, 0.0
    for t in range(first, end):
        if partner[t] < 0:
            n += 1
            for p in range(pair_start[t], pair_start[t + 1]):
                e = pair_estimate[p]
                if not taken[e]:
                    total_m += pair_m[p]
                    if column[e] == 0:
                        m += 1
                        column[e] = m
    if m == 0:
        return

    cost, name, i = np.empty((n, m)), np.empty(m, np.int64), 0
    for t in range(first, end):
        if partner[t] < 0:
            for j in range(m):
                cost[i, j] = np.inf
            for p in range(pair_start[t], pair_start[t + 1]):
                e = pair_estimate[p]
                if not taken[e]:
                    cost[i, column[e] - 1], name[column[e] - 1] = pair_m[p], e
            i += 1
    column_of = assign(cost, 2.0 * total_m + 1.0)  # more than all pairs together
    i = 0
    for t in range(first, end):
        if partner[t] < 0:
            j = column_of[i]
            if j >= 0:
                partner[t], meters[t], taken[name[j]] = name[j], cost[i, j], True
            i += 1
    for j in range(m):
        column[name[j]] = 0


@kernel_part
def _remember(history: Array, track: int, frame: int, is_matched: bool) -> None:
    """Bring what is known of a truth track up to date; `frame` counts samples with any box of the class."""
    if history[track, _BOXES] == 0:
        history[track, _FIRST], history[track, _NEXT] = frame, frame
    gap = history[track, _GAP] + frame - history[track, _NEXT]
    if is_matched:
        if history[track, _MATCHES] == 0:
            history[track, _FIRST_MATCH] = frame
        elif history[track, _MISSES] > 0:
            history[track, _BREAKS] += 1
        history[track, _LONGEST] = max(history[track, _LONGEST], gap)
        history[track, _GAP], history[track, _MISSES] = 0, 0
        history[track, _MATCHES] += 1
    else:
        history[track, _GAP] = gap + 1
        history[track, _MISSES] += 1
    history[track, _BOXES] += 1
    history[track, _NEXT] = frame + 1


@kernel_part
def _count_track(history: Array, track: int, counts: Array, i: int) -> None:
    if history[track, _BOXES] == 0:
        return
    share = history[track, _MATCHES] / history[track, _BOXES]
    counts[i, MT] += 1 if share >= 0.8 else 0
    counts[i, ML] += 1 if share < 0.2 else 0
    counts[i, FRAG] += history[track, _BREAKS]
    if history[track, _MATCHES] > 0:
        counts[i, FOUND] += 1
        counts[i, LATE] += history[track, _FIRST_MATCH] - history[track, _FIRST]
        counts[i, GAP] += max(history[track, _LONGEST], history[track, _GAP])
