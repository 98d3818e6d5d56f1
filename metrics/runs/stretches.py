"""One run cut in pieces that can be resampled: its segments, or equal stretches of time."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fbench.metrics.runs.columns import of_steps
from fbench.metrics.runs.view import View
from fbench.replay.arrays import Float64, Int64
from fbench.replay.store import Run

LEAST_S = 1.0
MOST = 20
_SLACK = 0.01
"""A stretch may be so much shorter: stamps jitter."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """Which piece of a run each of its frames with truth belongs to."""

    frame: Int64
    """(F,) ascending index of the frames."""
    piece: Int64
    """(F,) from 0 on."""
    unit: str
    """`segments`, or `stretches of 2.5 s`."""
    cuts_tracks: bool
    """Whether tracks go on from one piece to the next."""

    def views(self, view: View) -> Iterator[View]:
        """Yield the pieces of a view; tracks end where a piece does."""
        sequence = view.sequence
        piece = self.piece[np.searchsorted(self.frame, sequence.steps.frame)]
        for number in range(int(self.piece.max(initial=-1)) + 1):
            num_frames = int((self.piece == number).sum())
            yield replace(view, sequence=of_steps(sequence, piece == number), num_frames=num_frames)


def pieces(run: Run, least: int) -> Pieces | str:
    """Cut a run into segments, or where it has less than `least` of them into as many equal stretches of time as it
    has seconds, `MOST` at most; or say why it can't be cut so.
    """
    frames = sorted((f.index, f.segment, f.stamp_ns) for f in run.frames if f.truth_spaces)
    index, segment, stamp_ns = np.array(frames, np.int64).reshape(-1, 3).T
    segments, number = np.unique(segment, return_inverse=True)
    if len(segments) >= least:
        return Pieces(index, number.astype(np.int64), "segments", cuts_tracks=False)
    elapsed_s, duration_s = _elapsed(segment, stamp_ns)
    num = min(int(duration_s / LEAST_S / (1 - _SLACK)), MOST)
    if num < least:
        held = "1 segment" if len(segments) == 1 else f"{len(segments)} segments"
        return f"{duration_s:.3g} s with truth in {held}, at least {least} s or segments are needed"
    piece = np.minimum((elapsed_s / duration_s * num).astype(np.int64), num - 1)
    return Pieces(index, piece, f"stretches of {duration_s / num:.3g} s", cuts_tracks=True)


def _elapsed(segment: Int64, stamp_ns: Int64) -> tuple[Float64, float]:
    """Time (F,) [s] of each frame since the first, without the pauses between segments, and of all frames together."""
    if len(segment) < 2:
        return np.zeros(len(segment)), 0.0
    step_s = np.diff(stamp_ns) * 1e-9
    within = np.diff(segment) == 0
    usual = float(np.median(step_s[within])) if within.any() else 0.0
    elapsed = np.concatenate([[0.0], np.cumsum(np.where(within, np.maximum(step_s, 0.0), usual))])
    return elapsed, float(elapsed[-1]) + usual
