"""All scores of a run, in the order of `scores.json`."""

from collections.abc import Sequence

from fbench.metrics.runs.shared import SharedRun
from fbench.metrics.standard.groups import VEHICLE
from fbench.replay.protocols import Metric
from fbench.replay.scores import Score, ScoreOptions
from fbench.replay.store import Run

_ORDER = (
    "f1", "precision", "recall", "mota", "mota_no_fp", "motp", "idsw", "idf1", "hota", "best_f1", "best_f1_threshold",
    "ap", "deta", "assa", "loca", "idp", "idr", "frag", "mt", "pt", "ml", "occlusion_survival", "distance_error",
    "range_rate_error",
)  # fmt: skip

_FIRST = ("f1", "mota")
"""A metric's first row of these is in the pipeline's own space."""


def score_run(run: Run, options: ScoreOptions, metrics: Sequence[Metric]) -> list[Score]:
    """Return the rows of all metrics, primary rows first.

    All vehicles as one class come first, in the pipeline's own space, then in the image; then single labels; then
    slices; then what isn't about a class. Inside these, detection before tracking; rows of other metrics keep their
    order.

    Raises:
        MetricError: where truth or results can't be scored.
    """
    shared = SharedRun(run.folder)
    rows = [row for metric in metrics for row in metric.scores(shared, options)]
    return ordered(rows)


def ordered(rows: Sequence[Score]) -> list[Score]:
    """Return rows of one run, or of several together, primary rows first."""
    native = next((row.matching for row in rows if row.metric in _FIRST), "")
    classes = list(dict.fromkeys(row.class_ for row in rows))
    slices = list(dict.fromkeys(row.slice for row in rows))
    return sorted(rows, key=lambda row: _rank(row, native, classes, slices))


def _rank(row: Score, native: str, classes: Sequence[str], slices: Sequence[str]) -> tuple[int, int, int]:
    metric = _ORDER.index(row.metric) if row.metric in _ORDER else len(_ORDER)
    if row.slice != "all":
        return 3, slices.index(row.slice), metric
    if row.class_ == VEHICLE.name:
        return int(row.matching != native), 0, metric
    return (4, 0, metric) if row.class_ == "all" else (2, classes.index(row.class_), metric)
