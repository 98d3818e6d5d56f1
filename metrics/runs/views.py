"""The spaces in which a run is scored."""

from dataclasses import replace

import numpy as np

from fbench.metrics.profile import Match
from fbench.metrics.runs.ground import ground_view
from fbench.metrics.runs.image import image_view
from fbench.metrics.runs.view import View
from fbench.metrics.standard.groups import Group, label_group
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import LABELS
from fbench.replay.scores import ScoreOptions
from fbench.replay.store import Run
from fbench.replay.tables import BoxTable


def views(run: Run, table: BoxTable, options: ScoreOptions, match: Match | None = None) -> tuple[View, ...]:
    """Return the native view of a run first: 3D runs are scored in 3D and, projected, in the image.

    Args:
        run: With truth.
        table: Its detections or tracks.
        options: Which boxes count, and how they match.
        match: Instead of how the options match; then there is one view, in the image or not, as it needs.

    Raises:
        MetricError: where the match needs 3D boxes, and the results are in images.
    """
    if match is not None:
        flat = match.likeness == "iou2d"
        view = image_view(run, table, options) if flat else ground_view(run, table, options)
        _, comma, which = view.matching.partition(",")
        how = f"iou {match.threshold:g}" if flat else str(match)
        return (replace(view, match=match, matching=f"{how}{comma}{which}"),)
    image = image_view(run, table, options)
    return (ground_view(run, table, options), image) if isinstance(table.boxes, Boxes3D) else (image,)


def label_groups(view: View, table: BoxTable) -> tuple[Group, ...]:
    """Return a group for each label that truth or results have, where the pipeline knows labels."""
    if table.boxes.label is None:
        return ()
    truth, estimates = view.sequence.truth, view.sequence.estimates
    asked = truth.label if truth.ignore is None else truth.label[~truth.ignore]
    met = {*np.unique(asked).tolist(), *np.unique(estimates.label).tolist()}
    return tuple(label_group(label) for label in LABELS if label in met)
