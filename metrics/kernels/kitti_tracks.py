"""Compiled passes over the tracks of one sequence, one for each confidence threshold, as AB3DMOT counts them."""

import numpy as np

from fbench.metrics.kernels.kitti_matching import match_frame
from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.kernels import kernel

TP, IGNORED_TP, FP, FN, IGNORED_FN, IDS, FRAG, MT, PT, ML, IGNORED_TRACKS, TRUTH, RESULTS, IGNORED_RESULTS = range(14)
NUM_COUNTS = 14


@kernel
def count_passes(
    truth_start: Int64, estimate_start: Int64, pair_start: Int64, pair_estimate: Int64, pair_likeness: Float64,
    truth_ignored: Bool, track_start: Int64, track_rows: Int64, estimate_track: Int64, excusable: Bool,
    track_size: Int64, track_score: Float64, valid: Bool, thresholds: Float64, is_first: bool,
) -> tuple[Int64, Float64, Int64]:  # fmt: skip
    """Count each of K passes; return counts (K, 14), sums (K, 2) and the estimate of each truth row (N,) in the last.

    `track_score` (T,) and `valid` (M,) go on from pass to pass and are changed: AB3DMOT averages a track's scores
    anew before each pass but the first, and what was matched once is never excused again.
    The sums are those of likeness over matches, and of the mean likeness over frames, 1 where nothing is matched.
    """
    counts = np.zeros((len(thresholds), NUM_COUNTS), np.int64)
    sums = np.zeros((len(thresholds), 2))
    matched = np.full(len(truth_ignored), -1)
    likeness = np.zeros(len(truth_ignored))
    kept = np.zeros(len(valid), np.bool_)
    for k in range(len(thresholds)):
        if k > 0 or not is_first:
            _average(track_score, track_size)
        for j in range(len(kept)):
            kept[j] = not track_score[estimate_track[j]] < thresholds[k]
        for s in range(len(truth_start) - 1):
            t0, t1, e0, e1 = truth_start[s], truth_start[s + 1], estimate_start[s], estimate_start[s + 1]
            match_frame(t0, t1, e0, e1, pair_start, pair_estimate, pair_likeness, kept, matched, likeness)
            for i in range(t0, t1):
                if matched[i] >= 0:
                    valid[matched[i]] = True
            _count_results(e0, e1, kept, valid, excusable, counts[k])
            _count_truth(t0, t1, matched, likeness, truth_ignored, counts[k], sums[k])
        counts[k, FP] = counts[k, RESULTS] - counts[k, TP] - counts[k, IGNORED_RESULTS]
        for track in range(len(track_start) - 1):
            rows = track_rows[track_start[track] : track_start[track + 1]]
            _count_track(rows, matched, estimate_track, truth_ignored, counts[k])
    return counts, sums, matched


@kernel
def _average(track_score: Float64, track_size: Int64) -> None:
    """Average N equal scores by adding them one by one, which can round."""
    for track in range(len(track_score)):
        total = 0.0
        for _ in range(track_size[track]):
            total += track_score[track]
        track_score[track] = total / track_size[track]


@kernel
def _count_results(start: int, stop: int, kept: Bool, valid: Bool, excusable: Bool, counts: Int64) -> None:
    for j in range(start, stop):
        if kept[j]:
            counts[RESULTS] += 1
            if excusable[j] and not valid[j]:
                counts[IGNORED_RESULTS] += 1


@kernel
def _count_truth(
    start: int, stop: int, matched: Int64, likeness: Float64, ignored: Bool, counts: Int64, sums: Float64
) -> None:
    hits, total = 0, 0.0
    for i in range(start, stop):
        if matched[i] >= 0:
            counts[TP] += 1
            sums[0] += likeness[i]
            if ignored[i]:
                counts[IGNORED_TP] += 1
            else:
                hits += 1
                total += likeness[i]
        elif ignored[i]:
            counts[IGNORED_FN] += 1
        else:
            counts[FN] += 1
        if not ignored[i]:
            counts[TRUTH] += 1
    sums[1] += total / hits if hits > 0 else 1.0


@kernel
def _count_track(rows: Int64, matched: Int64, estimate_track: Int64, ignored: Bool, counts: Int64) -> None:
    """Add switches and fragments of one truth track, and whether it is mostly tracked."""
    num_rows = len(rows)
    ids = np.full(num_rows, -1)
    num_ignored, num_matched = 0, 0
    for f in range(num_rows):
        if matched[rows[f]] >= 0:
            ids[f] = estimate_track[matched[rows[f]]]
            num_matched += 1
        num_ignored += ignored[rows[f]]
    if num_ignored == num_rows:
        counts[IGNORED_TRACKS] += 1
        return
    if num_matched == 0:
        counts[ML] += 1
        return
    tracked = _follow(rows, ids, ignored, counts)
    share = tracked / (num_rows - num_ignored)
    counts[MT if share > 0.8 else ML if share < 0.2 else PT] += 1


@kernel
def _follow(rows: Int64, ids: Int64, ignored: Bool, counts: Int64) -> int:
    """Add switches and fragments; return in how many frames the track is tracked.

    The first frame counts as tracked even where it is ignored, and the last frame makes a fragment of its own.
    """
    num_rows = len(rows)
    last = ids[0]
    tracked = 1 if ids[0] >= 0 else 0
    for f in range(1, num_rows):
        if ignored[rows[f]]:
            last = -1
            continue
        seen = ids[f] != -1
        if seen and last != -1 and last != ids[f] and ids[f - 1] != -1:
            counts[IDS] += 1
        if seen and f < num_rows - 1 and ids[f - 1] != ids[f] and last != -1 and ids[f + 1] != -1:
            counts[FRAG] += 1
        if seen:
            tracked += 1
            last = ids[f]
            if f == num_rows - 1 and ids[f - 1] != ids[f]:
                counts[FRAG] += 1
    return tracked
