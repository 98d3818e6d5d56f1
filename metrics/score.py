"""All scores of a run, in the order of `scores.json`."""

from collections.abc import Sequence

from fbench.metrics.groups import VEHICLE
from fbench.metrics.prepare import views
from fbench.replay.protocols import Metric
from fbench.replay.scores import Score, ScoreOptions
from fbench.replay.store import Run

_ORDER = ("f1", "precision", "recall", "mota", "mota_no_fp", "motp", "idsw")


def score_run(run: Run, options: ScoreOptions, metrics: Sequence[Metric]) -> list[Score]:
    """Return the rows of all metrics, primary rows first.

    All vehicles as one class come first, in the pipeline's own space, then in the image; then single labels; then
    what isn't about a class. Inside these, detection before tracking; rows of other metrics keep their order.

    Raises:
        MetricError: where truth or results can't be scored.
    """
    native = views(run, run.detections, options)[0].space.matching
    rows = [row for metric in metrics for row in metric.scores(run, options)]
    classes = list(dict.fromkeys(row.class_ for row in rows))
    return sorted(rows, key=lambda row: _rank(row, native, classes))


def _rank(row: Score, native: str, classes: Sequence[str]) -> tuple[int, int, int]:
    metric = _ORDER.index(row.metric) if row.metric in _ORDER else len(_ORDER)
    if row.class_ == VEHICLE.name:
        return int(row.matching != native), 0, metric
    return (3, 0, metric) if row.class_ == "all" else (2, classes.index(row.class_), metric)
