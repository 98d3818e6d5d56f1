"""All scores of a run in the order of `scores.json`, with confidence intervals."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fbench.metrics.core.bootstrap import LEAST_UNITS, Bootstrap
from fbench.metrics.profiles.profile import Match
from fbench.metrics.runs import detection, tracking
from fbench.metrics.runs.columns import View, of_steps
from fbench.metrics.runs.combine import OF_TRACKS, RATES, RunTable, combined, measure_run, resampled, told_of
from fbench.metrics.runs.places import SharedRun
from fbench.metrics.runs.spaces import views
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.scores import Score, ScoreOptions
from fbench.replay.runs.folder import Run

LEAST_S = 1.0
MOST = 20
_SLACK = 0.01  # A stretch may be so much shorter: stamps jitter


@dataclass(frozen=True, eq=False)
class Pieces:
    """Which piece of a run each of its frames with truth belongs to."""

    frame: Int64  # (F,) ascending index of the frames
    piece: Int64  # (F,) from 0 on
    unit: str  # `segments`, or `stretches of 2.5 s`
    cuts_tracks: bool  # Whether tracks go on from one piece to the next

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


def intervals_of_run(
    run: Run, options: ScoreOptions, rows: list[Score], how: Bootstrap, match: Match | None = None
) -> list[Score]:
    """Return the rows of a run, those about all boxes of a class with intervals where they have a number.

    Segments are resampled; a run of fewer than `LEAST_UNITS` is cut into equal stretches of at least 1 s instead. That
    cuts tracks too, so only what depends on single steps gets an interval then: precision, recall, F1, MOTA and MOTP,
    but not IDF1 or HOTA. (A switch just at a cut is not seen in resamples; MOTA itself counts it.) Raises MetricError
    where an id occurs twice in one frame.
    """
    shared = SharedRun(run.folder)
    cut = pieces(shared, LEAST_UNITS)
    if isinstance(cut, str):
        return [_said(row, cut) if row.metric in (*RATES, *OF_TRACKS) else row for row in rows]
    metrics = RATES if cut.cuts_tracks else (*RATES, *OF_TRACKS)
    found = {_key(row): row for row in resampled(_tables(shared, options, cut, match), how, cut.unit, metrics)}
    rows = [_like(row, found.get(_key(row))) for row in rows]
    cut_too = f"{cut.unit} cut tracks"
    return [_said(row, cut_too) if cut.cuts_tracks and row.metric in OF_TRACKS else row for row in rows]


def _tables(run: Run, options: ScoreOptions, cut: Pieces, match: Match | None) -> dict[str, RunTable]:
    found = [list(cut.views(view)) for view in views(run, run.detections, options, match)]
    tracked = [list(cut.views(view)) for view in views(run, run.tracks, options, match)]
    tables = (
        RunTable(
            detection.whole_entries(one, run.detections), tracking.whole_entries(other, run.tracks), one[0].matching,
            one[0].num_scored, one[0].num_frames,
        )
        for one, other in zip(zip(*found, strict=True), zip(*tracked, strict=True), strict=True)
    )  # fmt: skip
    return {f"{number:06d}": table for number, table in enumerate(tables)}


def _like(row: Score, other: Score | None) -> Score:
    return row if other is None else replace(row, low=other.low, high=other.high, interval=other.interval)


def _said(row: Score, why: str) -> Score:
    return row if row.value is None or row.slice != "all" else replace(row, interval=why)


def _key(row: Score) -> tuple[str, str, str, str]:
    return row.metric, row.class_, row.slice, row.matching


_OPTIONS = ScoreOptions()


def own_rows(runs: Sequence[Run], match: Match | None, how: Bootstrap | None) -> tuple[list[Score], list[str]]:
    """Return the rows that runs have in their own `scores.json`, or together, and what there is to say of them.

    Args:
        runs: Of one pipeline, with truth.
        match: Instead of how fbench matches; the region of interest stays.
        how: Resamples for confidence intervals; none by default.

    Raises:
        MetricError: where the match needs 3D boxes and the results are in images, or an id is twice in a frame (GT003).
        ConfigError: where runs count different boxes.
    """
    measured = [measure_run(run, _OPTIONS, match) for run in runs]
    if len(measured) > 1:
        return combined(measured, how), told_of(measured)
    rows = measured[0].table.rows()
    return rows if how is None else intervals_of_run(runs[0], _OPTIONS, rows, how, match), []
