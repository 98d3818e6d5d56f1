"""Scores of runs with few labels, narrowed by what other pipelines gave on all frames."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fbench.api.scores import open_folder
from fbench.metrics.comparison.cells import CellSide
from fbench.metrics.comparison.control import Controlled, control
from fbench.metrics.comparison.counts import RATIOS, Place, options_of
from fbench.metrics.comparison.reference import count_agreement
from fbench.replay.contracts.errors import ConfigError, MetricError
from fbench.replay.data.arrays import Bool, Int64
from fbench.replay.runs.folder import Run


def estimate_by_controls(runs: Sequence[Path], controls: Sequence[Path]) -> Mapping[str, Controlled | str]:
    """Estimate F1, precision and recall of all vehicles over all frames of runs, labeled or not, in the pipelines' own
    space; or say why one of them has no estimate.

    Args:
        runs: Runs of one pipeline on different logs, scored by the same rules; some of their frames have truth, as if
            drawn at random.
        controls: Runs of other pipelines on the same logs: of each pipeline one for each run.

    Raises:
        ConfigError: where runs and controls don't belong together.
        MetricError: where too few frames are labeled, or all are; or scores aren't of this version of the metrics.
    """
    opened = [open_folder(folder) for folder in runs]
    _require_alike(opened)
    others = _group(opened, [open_folder(folder) for folder in controls])
    labels = [_count_labeled(run) for run in opened]
    for run, (place, _, _) in zip(opened, labels, strict=True):
        if place != labels[0][0]:
            raise MetricError(f"{run.folder}: is matched by {place[3]}, {opened[0].folder} by {labels[0][0][3]}")
    is_labeled = np.concatenate([own for _, _, own in labels])
    if is_labeled.all():
        raise MetricError("every frame is labeled: controls are for frames without labels; see --intervals")
    agreement = [
        np.concatenate([_count_all(run, one[run.manifest.data_key]) for run in opened]) for one in others.values()
    ]
    found = np.concatenate([counts for _, counts, _ in labels])
    return {metric: control(found, agreement, is_labeled, ratio) for metric, ratio in RATIOS["detection"].items()}


def _require_alike(runs: Sequence[Run]) -> None:
    """Refuse runs whose counts don't add up to those of one pipeline, or that count a log twice."""
    first, known = runs[0], dict[str, Run]()
    for run in runs:
        if run.manifest.pipeline != first.manifest.pipeline or run.manifest.parameters != first.manifest.parameters:
            raise ConfigError(f"{run.folder}: is of another pipeline or other parameters than {first.folder}")
        if options_of(run.scores) != options_of(first.scores):
            raise ConfigError(f"{run.folder}: was scored with other options than {first.folder}; run fbench score")
        if (other := known.setdefault(run.manifest.data_key, run)) is not run:
            raise ConfigError(f"{run.folder}: replayed the same as {other.folder}, whose frames would count twice")


def _group(runs: Sequence[Run], controls: Sequence[Run]) -> dict[str, dict[str, Run]]:
    """Controls by pipeline and what they replayed."""
    found: dict[str, dict[str, Run]] = {}
    for one in controls:
        of_pipeline = found.setdefault(one.manifest.pipeline, {})
        if (other := of_pipeline.setdefault(one.manifest.data_key, one)) is not one:
            raise ConfigError(f"--control {one.folder}: has pipeline and log of {other.folder}")
        first = next(iter(of_pipeline.values()))
        if one.manifest.parameters != first.manifest.parameters:
            raise ConfigError(f"--control {one.folder}: has other parameters than {first.folder}")
    for run in runs:
        for pipeline, own in found.items():
            if run.manifest.data_key not in own:
                raise ConfigError(f"--control: no run of '{pipeline}' is on the log of {run.folder}")
    return found


def _count_labeled(run: Run) -> tuple[Place, Int64, Bool]:
    """Where detections count first, their counts (n, 3) in frames labeled there, and which of all frames those are."""
    frames = CellSide.of(run).frames
    place = next((place for place in frames.counts if place[:3] == ("detection", "vehicle", "all")), None)
    spaces = [frame.truth_spaces.split() for frame in run.frames]
    # Images are judged by truth in space where there is none in images, see `image_view`.
    needed = "2d" if place and place[3].startswith("iou") and any("2d" in own for own in spaces) else "3d"
    is_labeled = np.array([needed in own for own in spaces])
    if place is None or not is_labeled.any():
        raise MetricError(f"{run.folder}: no frame has truth")
    has_truth = np.array([bool(own) for own in spaces])
    return place, frames.counts[place][is_labeled[has_truth]], is_labeled


def _count_all(run: Run, other: Run) -> Int64:
    counts, index = count_agreement(run, other)
    if len(index) != len(run.frames):
        raise ConfigError(f"--control {other.folder}: has other frames than {run.folder}")
    return counts
