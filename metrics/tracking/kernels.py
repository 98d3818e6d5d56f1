"""Compiled loops of CLEAR and identity."""

import numpy as np

from fbench.metrics.core.assignment_kernel import assign
from fbench.metrics.tracking.clear_events import ASCEND, MIGRATE, START, SWITCH, TRANSFER
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.geometry.kernels import kernel

CONTINUITY = 1000.0  # What a remembered pair counts more than others, where it isn't settled first (TrackEval 1.3.0)

MEMORY = 3  # Numbers that `follow` remembers of each track
_PARTNER, _STEP, _HELD = 0, 1, 2
"""Of each truth track: id and step of its last match, and whether it was matched where it last counted."""
_OWNER, _MATCHED, _COLUMN = 0, 1, 2
"""Of each estimated track: the truth track it was last assigned to, whether it was ever matched, and its column."""


@kernel
def follow(  # noqa: C901  # apart it compiles twice as long
    truth_start: Int64, estimate_start: Int64, block_start: Int64, similarity: Float64, stream: Int64,
    truth_id: Int64, estimate_id: Int64, floor: float, offset: float, remember_last: bool, settle_first: bool,
    most_pairs: bool, own_frames: bool, tracks: Int64, others: Int64, last_step: Int64, partner: Int64, event: Int64,
) -> None:  # fmt: skip
    """Fill in the estimate of each truth box (N,), and what the match is besides (N,); misses stay as they are.

    Offsets of steps are (S + 1,), `similarity` is (B,), `stream` (S,), `truth_id` (N,) and `estimate_id` (M,). For own
    use are `tracks` (truth tracks, MEMORY), `others` (estimated tracks, MEMORY) and `last_step` (streams,), all -1;
    `partner` (N,) is all -1 and `event` (N,) all 0.

    Args:
        floor: Similarity that a pair needs.
        offset: Added to a pair's similarity before the best sum is looked for.
        remember_last: A truth track's last match is remembered, after any gap; else only that of the previous step
            of its stream in which there was truth and an estimate.
        settle_first: Remembered pairs are made first, in the order of truth rows; else they count `CONTINUITY` more.
        most_pairs: As many pairs as possible, then the best sum; else the best sum alone.
        own_frames: A truth track is interrupted by a frame of its own without match; else by any step without match
            that counts for the memory.
    """
    bonus = 0.0 if settle_first else CONTINUITY
    for step in range(len(stream)):
        first, other, b = truth_start[step], estimate_start[step], block_start[step]
        n, m = truth_start[step + 1] - first, estimate_start[step + 1] - other
        if n == 0 or m == 0:
            if own_frames:
                for i in range(n):
                    tracks[truth_id[first + i], _HELD] = 0
            continue
        previous = last_step[stream[step]]
        last_step[stream[step]] = step

        remembered, is_settled, is_taken = np.empty(n, np.int64), np.empty(n, np.bool_), np.empty(m, np.bool_)
        for j in range(m):
            others[estimate_id[other + j], _COLUMN], is_taken[j] = j, False
        for i in range(n):
            g, j = truth_id[first + i], -1
            if tracks[g, _PARTNER] >= 0 and (remember_last or tracks[g, _STEP] == previous):
                j = others[tracks[g, _PARTNER], _COLUMN]
            remembered[i], is_settled[i] = j, False
            if settle_first and j >= 0 and not is_taken[j] and similarity[b + i * m + j] >= floor:
                is_settled[i], is_taken[j] = True, True
        for j in range(m):
            others[estimate_id[other + j], _COLUMN] = -1

        cost, worst = np.empty((n, m)), 0.0
        for i in range(n):
            for j in range(m):
                value = similarity[b + i * m + j]
                cost[i, j] = np.inf
                if value >= floor and not is_settled[i] and not is_taken[j]:
                    gain = (bonus if remembered[i] == j else 0.0) + (value + offset)
                    cost[i, j] = -gain
                    worst = max(worst, abs(gain))
        column_of = assign(cost, 2.0 * min(n, m) * (worst + 1.0) + 1.0 if most_pairs else 0.0)

        for i in range(n):
            g, j = truth_id[first + i], remembered[i] if is_settled[i] else column_of[i]
            if not own_frames:
                tracks[g, _HELD] = 1 if previous >= 0 and tracks[g, _STEP] == previous else 0
            if j < 0:
                tracks[g, _HELD] = 0
                continue
            h, last = estimate_id[other + j], tracks[g, _PARTNER]
            what = 0 if tracks[g, _HELD] == 1 else START
            if last >= 0 and last != h:
                what |= SWITCH if others[h, _MATCHED] == 1 else SWITCH | ASCEND
            if not is_settled[i]:
                if others[h, _OWNER] >= 0 and others[h, _OWNER] != g:
                    what |= TRANSFER if last >= 0 else TRANSFER | MIGRATE
                others[h, _OWNER] = g
            tracks[g, _PARTNER], tracks[g, _STEP], tracks[g, _HELD], others[h, _MATCHED] = h, step, 1, 1
            partner[first + i], event[first + i] = other + j, what


@kernel
def link_groups(row: Int64, column: Int64, parent: Int64) -> Int64:
    """Return the group (P,) of each pair, from 0: pairs that share a row or column, also by way of others, are in one.

    `column` (P,) is numbered on from the rows (P,); `parent` (rows and columns,) is each its own, for own use.
    """
    for k in range(len(row)):
        a, b = row[k], column[k]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        if a < b:
            parent[b] = a
        else:
            parent[a] = b
    group, num = np.empty(len(row), np.int64), 0
    for node in range(len(parent)):  # a parent comes before its children
        if parent[node] == node:
            parent[node] = -1 - num
            num += 1
        else:
            parent[node] = parent[parent[node]]
    for k in range(len(row)):
        group[k] = -1 - parent[row[k]]
    return group
