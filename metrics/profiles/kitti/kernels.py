"""Compiled matching of KITTI's object benchmark and of AB3DMOT's passes."""

import math

import numpy as np

from fbench.metrics.core.assignment_kernel import assign
from fbench.metrics.core.sums_kernel import LIMBS, add_exact
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.geometry.kernels import kernel, kernel_part


@kernel
def match_frame(  # noqa: C901  # apart it compiles twice as long
    truth_first: int, truth_stop: int, estimate_first: int, estimate_stop: int, pair_start: Int64,
    pair_estimate: Int64, pair_similarity: Float64, kept: Bool, matched: Int64, similarity: Float64,
) -> None:  # fmt: skip
    """Write for the truth rows of a frame which estimate each gets (-1: none) and how alike they are.

    Pairs that no other pair touches are taken at once; only what is left is solved. There, a column for each truth row
    stands for no estimate, at a cost no pair reaches.
    """
    num_columns = estimate_stop - estimate_first
    degree, rows, num_left = np.empty(num_columns, np.int64), np.empty(truth_stop - truth_first, np.int64), 0
    for j in range(num_columns):
        degree[j] = 0
    for i in range(truth_first, truth_stop):
        for p in range(pair_start[i], pair_start[i + 1]):
            if kept[pair_estimate[p]]:
                degree[pair_estimate[p] - estimate_first] += 1
    for i in range(truth_first, truth_stop):
        matched[i], similarity[i] = -1, 0.0
        own, pair = 0, -1
        for p in range(pair_start[i], pair_start[i + 1]):
            if kept[pair_estimate[p]]:
                own, pair = own + 1, p
        if own == 1 and degree[pair_estimate[pair] - estimate_first] == 1:
            matched[i], similarity[i] = pair_estimate[pair], pair_similarity[pair]
        elif own > 0:
            rows[num_left] = i
            num_left += 1
    if num_left == 0:
        return

    cost = np.empty((num_left, num_columns + num_left))
    for r in range(num_left):
        i = rows[r]
        for j in range(num_columns + num_left):
            cost[r, j] = np.inf
        cost[r, num_columns + r] = num_left + 1.0
        for p in range(pair_start[i], pair_start[i + 1]):
            if kept[pair_estimate[p]]:
                cost[r, pair_estimate[p] - estimate_first] = 1.0 - pair_similarity[p]
    columns = assign(cost, np.inf)
    for r in range(num_left):
        i, j = rows[r], columns[r]
        if j < num_columns:
            matched[i], similarity[i] = estimate_first + j, 1.0 - cost[r, j]


COUNTS, IGNORED, LEFT_OUT = 0, 1, -1  # What a result is for a class and difficulty


@kernel
def hit_scores(
    pair_start: Int64, pair_estimate: Int64, pair_similarity: Float64, truth_ignored: Bool, state: Int64,
    score: Float64, overlap: float,
) -> Float64:  # fmt: skip
    """Return the score (N,) of the result that each truth row takes, NaN where it isn't a hit.

    The surest result above the overlap is taken; of equally sure ones the first.
    """
    taken, scores = np.empty(len(score), np.bool_), np.empty(len(truth_ignored))
    for j in range(len(taken)):
        taken[j] = False
    for i in range(len(truth_ignored)):
        scores[i], best = np.nan, -1
        for p in range(pair_start[i], pair_start[i + 1]):
            j = pair_estimate[p]
            free = state[j] != LEFT_OUT and not taken[j]
            if free and pair_similarity[p] > overlap and (best < 0 or score[j] > score[best]):
                best = j
        if best >= 0:
            taken[best] = True
            if not truth_ignored[i] and state[best] == COUNTS:
                scores[i] = score[best]
    return scores


@kernel
def count_at(  # noqa: C901  # zeroed in loops, which compile faster than `np.zeros`
    pair_start: Int64, pair_estimate: Int64, pair_similarity: Float64, truth_ignored: Bool, state: Int64,
    score: Float64, overlap: float, covered: Bool, turned: Float64, thresholds: Float64,
) -> tuple[Int64, Int64]:  # fmt: skip
    """Return counts (K, 3) of hits, false positives and misses at each threshold, and digits (K, LIMBS) of the sum of
    their similarity of heading.

    `turned` (P,) is the similarity of heading of each pair, `covered` (M,) results that are excused where they match
    nothing.
    """
    counts, digits = np.empty((len(thresholds), 3), np.int64), np.empty((len(thresholds), LIMBS), np.int64)
    taken = np.empty(len(score), np.bool_)
    for k in range(len(thresholds)):
        for c in range(3):
            counts[k, c] = 0
        for c in range(LIMBS):
            digits[k, c] = 0
        for j in range(len(taken)):
            taken[j] = False
        for i in range(len(truth_ignored)):
            best = _nearest(
                pair_start[i], pair_start[i + 1], pair_estimate, pair_similarity, state, score, overlap, thresholds[k],
                taken,
            )  # fmt: skip
            if best >= 0:
                j = pair_estimate[best]
                taken[j] = True
                if not truth_ignored[i] and state[j] == COUNTS:
                    counts[k, 0] += 1
                    add_exact(digits[k], turned[best])
            elif not truth_ignored[i]:
                counts[k, 2] += 1
        for j in range(len(score)):
            if not taken[j] and state[j] == COUNTS and score[j] >= thresholds[k] and not covered[j]:
                counts[k, 1] += 1
    return counts, digits


@kernel_part
def _nearest(
    start: int, stop: int, pair_estimate: Int64, pair_similarity: Float64, state: Int64, score: Float64,
    overlap: float, threshold: float, taken: Bool,
) -> int:  # fmt: skip
    """Return the pair with the largest overlap; the first ignored result only where no other is near enough."""
    best, is_ignored = -1, False
    for p in range(start, stop):
        j = pair_estimate[p]
        if state[j] == LEFT_OUT or taken[j] or score[j] < threshold or not pair_similarity[p] > overlap:
            continue
        if state[j] == COUNTS and (best < 0 or is_ignored or pair_similarity[p] > pair_similarity[best]):
            best, is_ignored = p, False
        elif state[j] == IGNORED and best < 0:
            best, is_ignored = p, True
    return best


@kernel
def heading_similarity(pair_start: Int64, pair_estimate: Int64, truth_alpha: Float64, alpha: Float64) -> Float64:
    """Similarity (P,) of observation angles, (1 + cos) / 2."""
    similarity = np.empty(len(pair_estimate))
    for i in range(len(truth_alpha)):
        for p in range(pair_start[i], pair_start[i + 1]):
            similarity[p] = (1.0 + math.cos(truth_alpha[i] - alpha[pair_estimate[p]])) / 2.0
    return similarity


TP, IGNORED_TP, FP, FN, IGNORED_FN, IDS, FRAG, MT, PT, ML, IGNORED_TRACKS, TRUTH, RESULTS, IGNORED_RESULTS = range(14)
NUM_COUNTS = 14


@kernel
def count_passes(  # noqa: C901  # apart it compiles twice as long
    truth_start: Int64, estimate_start: Int64, pair_start: Int64, pair_estimate: Int64, pair_similarity: Float64,
    truth_ignored: Bool, track_start: Int64, track_rows: Int64, estimate_track: Int64, excusable: Bool,
    track_size: Int64, track_score: Float64, valid: Bool, thresholds: Float64, is_first: bool,
) -> tuple[Int64, Float64, Int64]:  # fmt: skip
    """Count each of K passes; return counts (K, 14), sums (K, 2) and the estimate of each truth row (N,) in the last.

    `track_score` (T,) and `valid` (M,) go on from pass to pass and are changed: AB3DMOT averages a track's scores
    anew before each pass but the first, and what was matched once is never excused again.
    The sums are those of similarity over matches, and of the mean similarity over frames, 1 where nothing is matched.
    """
    counts, sums = np.empty((len(thresholds), NUM_COUNTS), np.int64), np.empty((len(thresholds), 2))
    matched, similarity = np.empty(len(truth_ignored), np.int64), np.empty(len(truth_ignored))
    kept = np.empty(len(valid), np.bool_)
    for i in range(len(matched)):
        matched[i] = -1
    for k in range(len(thresholds)):
        sums[k, 0], sums[k, 1] = 0.0, 0.0
        for c in range(NUM_COUNTS):
            counts[k, c] = 0
        if k > 0 or not is_first:  # average N equal scores by adding them one by one, which can round
            for track in range(len(track_score)):
                total = 0.0
                for _ in range(track_size[track]):
                    total += track_score[track]
                track_score[track] = total / track_size[track]
        for j in range(len(kept)):
            kept[j] = not track_score[estimate_track[j]] < thresholds[k]

        for s in range(len(truth_start) - 1):
            t0, t1, e0, e1 = truth_start[s], truth_start[s + 1], estimate_start[s], estimate_start[s + 1]
            match_frame(t0, t1, e0, e1, pair_start, pair_estimate, pair_similarity, kept, matched, similarity)
            hits, total = 0, 0.0
            for i in range(t0, t1):
                if matched[i] >= 0:
                    valid[matched[i]] = True
                    counts[k, TP] += 1
                    sums[k, 0] += similarity[i]
                    if truth_ignored[i]:
                        counts[k, IGNORED_TP] += 1
                    else:
                        hits += 1
                        total += similarity[i]
                else:
                    counts[k, IGNORED_FN if truth_ignored[i] else FN] += 1
                if not truth_ignored[i]:
                    counts[k, TRUTH] += 1
            sums[k, 1] += total / hits if hits > 0 else 1.0
            for j in range(e0, e1):
                if kept[j]:
                    counts[k, RESULTS] += 1
                    if excusable[j] and not valid[j]:
                        counts[k, IGNORED_RESULTS] += 1
        counts[k, FP] = counts[k, RESULTS] - counts[k, TP] - counts[k, IGNORED_RESULTS]
        for track in range(len(track_start) - 1):
            _count_track(
                track_rows, track_start[track], track_start[track + 1], matched, estimate_track, truth_ignored, counts,
                k,
            )  # fmt: skip
    return counts, sums, matched


@kernel_part
def _count_track(  # apart it compiles twice as long
    rows: Int64, start: int, stop: int, matched: Int64, estimate_track: Int64, ignored: Bool, counts: Int64, k: int
) -> None:
    """Add switches and fragments of the truth track in `rows[start:stop]`, and whether it is mostly tracked.

    The first frame counts as tracked even where it is ignored, and the last frame makes a fragment of its own.
    """
    ids = np.empty(stop - start, np.int64)
    num_ignored, num_matched = 0, 0
    for f in range(len(ids)):
        row = rows[start + f]
        ids[f] = estimate_track[matched[row]] if matched[row] >= 0 else -1
        num_matched += 1 if matched[row] >= 0 else 0
        num_ignored += 1 if ignored[row] else 0
    if num_ignored == len(ids):
        counts[k, IGNORED_TRACKS] += 1
        return
    if num_matched == 0:
        counts[k, ML] += 1
        return

    last, tracked, end = ids[0], 1 if ids[0] >= 0 else 0, len(ids) - 1
    for f in range(1, len(ids)):
        if ignored[rows[start + f]]:
            last = -1
        elif ids[f] != -1:
            if last != -1 and last != ids[f] and ids[f - 1] != -1:
                counts[k, IDS] += 1
            if f < end and ids[f - 1] != ids[f] and last != -1 and ids[f + 1] != -1:
                counts[k, FRAG] += 1
            if f == end and ids[f - 1] != ids[f]:
                counts[k, FRAG] += 1
            tracked, last = tracked + 1, ids[f]
    share = tracked / (len(ids) - num_ignored)
    counts[k, MT if share > 0.8 else ML if share < 0.2 else PT] += 1
