"""Scores of one run with confidence intervals."""

from dataclasses import replace

from fbench.metrics.combine import OF_TRACKS, RATES, RunTable, resampled
from fbench.metrics.profile import Match
from fbench.metrics.runs import detection, tracking
from fbench.metrics.runs.shared import SharedRun
from fbench.metrics.runs.stretches import Pieces, pieces
from fbench.metrics.runs.views import views
from fbench.metrics.statistics.bootstrap import LEAST_UNITS, Bootstrap
from fbench.replay.scores import Score, ScoreOptions
from fbench.replay.store import Run


def intervals_of_run(
    run: Run, options: ScoreOptions, rows: list[Score], how: Bootstrap, match: Match | None = None
) -> list[Score]:
    """Return the rows of a run, those about all boxes of a class with intervals where they have a number.

    Segments are resampled; a run of fewer than `LEAST_UNITS` is cut into equal stretches of at least 1 s instead. That
    cuts tracks too, so only what depends on single steps gets an interval then: precision, recall, F1, MOTA and MOTP,
    but not IDF1 or HOTA. (A switch just at a cut is not seen in resamples; MOTA itself counts it.)

    Raises:
        MetricError: where an id occurs twice in one frame.
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
