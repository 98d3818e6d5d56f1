"""CLEAR: pairs of one step after the other, with a memory of earlier ones."""

import numpy as np

from fbench.metrics.kernels.assignment import assign
from fbench.metrics.kernels.assignment_steps import lonely
from fbench.metrics.kernels.clear_events import ASCEND, MIGRATE, START, SWITCH, TRANSFER
from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.kernels import kernel

CONTINUITY = 1000.0
"""What a remembered pair counts more than others, where it isn't settled first (TrackEval 1.3.0)."""

_PARTNER, _STEP, _HELD = 0, 1, 2
"""Of each truth track: id and step of its last match, and whether it was matched where it last counted."""
_OWNER, _MATCHED, _COLUMN = 0, 1, 2
"""Of each estimated track: the truth track it was last assigned to, whether it was ever matched, and its column."""


@kernel
def follow(
    truth_start: Int64, estimate_start: Int64, block_start: Int64, similarity: Float64, stream: Int64,
    truth_id: Int64, estimate_id: Int64, floor: float, offset: float, remember_last: bool, settle_first: bool,
    most_pairs: bool, own_frames: bool,
) -> tuple[Int64, Int64]:  # fmt: skip
    """Return the estimate of each truth box (N,), -1 for a miss, and what the match is besides (N,).

    Args:
        truth_start: (S + 1,)
        estimate_start: (S + 1,)
        block_start: (S + 1,)
        similarity: (B,)
        stream: (S,)
        truth_id: (N,)
        estimate_id: (M,)
        floor: Similarity that a pair needs.
        offset: Added to a pair's similarity before the best sum is looked for.
        remember_last: A truth track's last match is remembered, after any gap; else only that of the previous step
            of its stream in which there was truth and an estimate.
        settle_first: Remembered pairs are made first, in the order of truth rows; else they count `CONTINUITY` more.
        most_pairs: As many pairs as possible, then the best sum; else the best sum alone.
        own_frames: A truth track is interrupted by a frame of its own without match; else by any step without match
            that counts for the memory.
    """
    partner, event = np.full(len(truth_id), -1, np.int64), np.zeros(len(truth_id), np.int64)
    tracks = np.full((truth_id.max() + 1, 3), -1, np.int64)
    others = np.full((estimate_id.max() + 1, 3), -1, np.int64)
    last_step = np.full(stream.max() + 1, -1, np.int64)
    for step in range(len(stream)):
        truth = truth_id[truth_start[step] : truth_start[step + 1]]
        estimates = estimate_id[estimate_start[step] : estimate_start[step + 1]]
        n, m = len(truth), len(estimates)
        if n == 0 or m == 0:
            for g in truth:
                tracks[g, _HELD] = 0 if own_frames else tracks[g, _HELD]
            continue
        previous, last_step[stream[step]] = last_step[stream[step]], step
        remembered = _remembered(truth, estimates, tracks, others, previous, remember_last)
        block = similarity[block_start[step] : block_start[step] + n * m].copy().reshape(n, m)
        column_of, settled = np.full(n, -1, np.int64), np.zeros(n, np.bool_)
        if settle_first:
            _settle(block, floor, remembered, settled, column_of)
        _pair_up(block, floor, offset, 0.0 if settle_first else CONTINUITY, remembered, settled, most_pairs, column_of)
        for i in range(n):
            g, at = truth[i], truth_start[step] + i
            if not own_frames:
                tracks[g, _HELD] = previous >= 0 and tracks[g, _STEP] == previous
            if column_of[i] < 0:
                tracks[g, _HELD] = 0
            else:
                partner[at] = estimate_start[step] + column_of[i]
                event[at] = _event(g, estimates[column_of[i]], step, settled[i], tracks, others)
    return partner, event


@kernel
def _remembered(
    truth: Int64, estimates: Int64, tracks: Int64, others: Int64, previous: int, remember_last: bool
) -> Int64:
    """Return the column (n,) of the estimate with which each truth box should go on, -1 without one."""
    for j in range(len(estimates)):
        others[estimates[j], _COLUMN] = j
    columns = np.full(len(truth), -1, np.int64)
    for i in range(len(truth)):
        g = truth[i]
        if tracks[g, _PARTNER] >= 0 and (remember_last or tracks[g, _STEP] == previous):
            columns[i] = others[tracks[g, _PARTNER], _COLUMN]
    for h in estimates:
        others[h, _COLUMN] = -1
    return columns


@kernel
def _event(g: int, h: int, step: int, is_settled: bool, tracks: Int64, others: Int64) -> int:
    """Remember the match of truth track `g` with estimated track `h`, and return what it is besides."""
    what = 0 if tracks[g, _HELD] == 1 else START
    partner = tracks[g, _PARTNER]
    if partner >= 0 and partner != h:
        what |= SWITCH if others[h, _MATCHED] == 1 else SWITCH | ASCEND
    if not is_settled:
        if others[h, _OWNER] >= 0 and others[h, _OWNER] != g:
            what |= TRANSFER if partner >= 0 else TRANSFER | MIGRATE
        others[h, _OWNER] = g
    tracks[g, _PARTNER], tracks[g, _STEP], tracks[g, _HELD], others[h, _MATCHED] = h, step, 1, 1
    return what


@kernel
def _settle(block: Float64, floor: float, remembered: Int64, settled: Bool, column_of: Int64) -> None:
    """Make the remembered pairs that are near enough, and rule out all others of their rows and columns."""
    n = block.shape[0]
    for i in range(n):
        j = remembered[i]
        if j >= 0 and block[i, j] >= floor:
            settled[i], column_of[i] = True, j
            block[i, :] = -np.inf
            block[:, j] = -np.inf


@kernel
def _pair_up(
    block: Float64, floor: float, offset: float, bonus: float, remembered: Int64, settled: Bool, most_pairs: bool,
    column_of: Int64,
) -> None:  # fmt: skip
    """Fill in the columns of rows that aren't settled."""
    n, m = block.shape
    near, gain, worst = np.zeros((n, m)), np.zeros((n, m)), 0.0
    for i in range(n):
        for j in range(m):
            if block[i, j] >= floor:
                near[i, j] = 1.0
                gain[i, j] = (bonus if remembered[i] == j else 0.0) + (block[i, j] + offset)
                worst = max(worst, abs(gain[i, j]))
    free = np.empty(n, np.int64)
    if not lonely(near, free):
        without = 2.0 * min(n, m) * (worst + 1.0) + 1.0 if most_pairs else 0.0
        free = assign(np.where(near > 0.0, -gain, without))
    for i in range(n):
        if not settled[i] and free[i] >= 0 and near[i, free[i]] > 0.0:
            column_of[i] = free[i]
