"""Compiled passes over the tracks of one sequence, one for each confidence threshold, as AB3DMOT counts them."""

import numpy as np

from fbench.metrics.kernels.kitti_matching import match_frame
from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.kernels import kernel

TP, IGNORED_TP, FP, FN, IGNORED_FN, IDS, FRAG, MT, PT, ML, IGNORED_TRACKS, TRUTH, RESULTS, IGNORED_RESULTS = range(14)
NUM_COUNTS = 14


@kernel
def count_passes(  # noqa: C901  # apart it compiles twice as long
    truth_start: Int64, estimate_start: Int64, pair_start: Int64, pair_estimate: Int64, pair_likeness: Float64,
    truth_ignored: Bool, track_start: Int64, track_rows: Int64, estimate_track: Int64, excusable: Bool,
    track_size: Int64, track_score: Float64, valid: Bool, thresholds: Float64, is_first: bool,
) -> tuple[Int64, Float64, Int64]:  # fmt: skip
    """Count each of K passes; return counts (K, 14), sums (K, 2) and the estimate of each truth row (N,) in the last.

    `track_score` (T,) and `valid` (M,) go on from pass to pass and are changed: AB3DMOT averages a track's scores
    anew before each pass but the first, and what was matched once is never excused again.
    The sums are those of likeness over matches, and of the mean likeness over frames, 1 where nothing is matched.
    """
    counts, sums = np.empty((len(thresholds), NUM_COUNTS), np.int64), np.empty((len(thresholds), 2))
    matched, likeness = np.empty(len(truth_ignored), np.int64), np.empty(len(truth_ignored))
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
            match_frame(t0, t1, e0, e1, pair_start, pair_estimate, pair_likeness, kept, matched, likeness)
            hits, total = 0, 0.0
            for i in range(t0, t1):
                if matched[i] >= 0:
                    valid[matched[i]] = True
                    counts[k, TP] += 1
                    sums[k, 0] += likeness[i]
                    if truth_ignored[i]:
                        counts[k, IGNORED_TP] += 1
                    else:
                        hits += 1
                        total += likeness[i]
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


@kernel
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
