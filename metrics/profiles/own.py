"""The profile `default` of runs, which is their own scoring."""

from collections.abc import Sequence

from fbench.metrics.combine import combined, measure_run, told_of
from fbench.metrics.one_run import intervals_of_run
from fbench.metrics.profile import Match
from fbench.metrics.statistics.bootstrap import Bootstrap
from fbench.replay.scores import Score, ScoreOptions
from fbench.replay.store import Run

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
