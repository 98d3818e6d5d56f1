"""All scores of a run in the order of `scores.json`, with confidence intervals."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fbench.metrics.core.bootstrap import LEAST_UNITS, Bootstrap
from fbench.metrics.detection.scores import DetectionCounts, detection_counts
from fbench.metrics.runs import combine
from fbench.metrics.runs.columns import View, of_steps
from fbench.metrics.runs.combine import OF_TRACKS, RATES, RunTable
from fbench.metrics.runs.places import SharedRun
from fbench.metrics.runs.spaces import measure_classes, views
from fbench.metrics.runs.tracking import measure_tracks
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.arrays import Int64
from fbench.replay.data.scores import Score, ScoreOptions, format_count
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
            num_frames = 0 if view.key.reason else int((self.piece == number).sum())
            key = replace(view.key, num_frames=num_frames)
            yield View(view.match, of_steps(sequence, piece == number), key)


def cut_run(run: Run, least: int) -> Pieces | str:
    """Cut a run into segments, or where it has less than `least` of them into as many equal stretches of time as it
    has seconds, `MOST` at most; or say why it can't be cut so.
    """
    frames = sorted((f.index, f.segment, f.stamp_ns) for f in run.frames if f.truth_spaces)
    index, segment, stamp_ns = np.array(frames, np.int64).reshape(-1, 3).T
    segments, number = np.unique(segment, return_inverse=True)
    if len(segments) >= least:
        return Pieces(index, number.astype(np.int64), "segments", cuts_tracks=False)
    # Time of each frame since the first, without the pauses between segments, and of all frames together.
    step_s, within = np.diff(stamp_ns) * 1e-9, np.diff(segment) == 0
    usual = float(np.median(step_s[within])) if within.any() else 0.0
    elapsed_s = np.cumsum(np.append(0.0, np.where(within, np.maximum(step_s, 0.0), usual)))
    duration_s = float(elapsed_s[-1]) + usual if len(segment) > 1 else 0.0
    num = min(int(duration_s / LEAST_S / (1 - _SLACK)), MOST)
    if num < least:
        held = format_count(len(segments), "segment")
        return f"{duration_s:.3g} s with truth in {held}, at least {least} s or segments are needed"
    piece = np.minimum((elapsed_s / duration_s * num).astype(np.int64), num - 1)
    return Pieces(index, piece, f"stretches of {duration_s / num:.3g} s", cuts_tracks=True)


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
    cut = cut_run(shared, LEAST_UNITS)
    if isinstance(cut, str):
        return [_say(row, cut, (*RATES, *OF_TRACKS)) for row in rows]
    tables = measure_pieces(shared, cut, options, match)
    metrics = RATES if cut.cuts_tracks else (*RATES, *OF_TRACKS)
    rows = combine.copy_intervals(combine.resample(tables, how, cut.unit, metrics), rows)
    return [_say(row, f"{cut.unit} cut tracks", OF_TRACKS) for row in rows] if cut.cuts_tracks else rows


def measure_pieces(
    shared: SharedRun, cut: Pieces, options: ScoreOptions, match: Match | None = None
) -> dict[str, RunTable]:
    """Return the statistics of each piece of a run by its number, as text that sorts. Raises MetricError where an id
    occurs twice in one frame.
    """
    detections, tracks = (
        zip(*(cut.views(view) for view in views(shared, table, options, match)), strict=True)
        for table in (shared.detections, shared.tracks)
    )
    return {
        f"{number:06d}": RunTable(
            measure_classes(found, shared.detections, detection_counts, DetectionCounts()),
            measure_tracks(shared, tracked),
            found[0].key.matching, found[0].key.num_frames, int((cut.piece == number).sum()),
        )
        for number, (found, tracked) in enumerate(zip(detections, tracks, strict=True))
    }  # fmt: skip


def _say(row: Score, why: str, metrics: Sequence[str]) -> Score:
    if row.metric not in metrics or row.value is None or row.slice != "all":
        return row
    return replace(row, interval=why)


def own_rows(runs: Sequence[Run], match: Match | None, how: Bootstrap | None) -> tuple[list[Score], list[str]]:
    """Return the rows that runs have in their own `scores.json`, or together, and what there is to say of them.

    Runs are of one pipeline, with truth; a `match` stands instead of how fbench matches, the region of interest stays;
    with resamples, `how`, there are confidence intervals. Raises MetricError where the match needs 3D boxes and the
    results are in images, or an id is twice in a frame (GT003); ConfigError where runs count different boxes.
    """
    options = ScoreOptions()
    measured = [combine.measure_run(run, options, match) for run in runs]
    if len(measured) > 1:
        return combine.combine_runs(measured, how), combine.describe_gaps(measured)
    rows = measured[0].table.rows()
    return rows if how is None else intervals_of_run(runs[0], options, rows, how, match), []
