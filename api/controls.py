"""Scores of runs with few labels, narrowed by what other pipelines gave on all frames."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fbench.api.scores import open_folder
from fbench.metrics.comparison.control import Controlled, control
from fbench.metrics.comparison.counts import RATIOS, count_frames, options_of
from fbench.metrics.comparison.reference import count_agreement
from fbench.replay.contracts.errors import ConfigError, MetricError
from fbench.replay.data.arrays import Bool, Int64
from fbench.replay.runs.folder import Run


def estimate_by_controls(runs: Sequence[Path], controls: Sequence[Path]) -> Mapping[str, Controlled]:
    """Estimate F1, precision and recall of all vehicles over all frames of runs, labeled or not, in the pipelines' own
    space.

    Args:
        runs: Runs of one pipeline, scored; some of their frames have truth, as if drawn at random.
        controls: Runs of other pipelines on the same logs: of each pipeline one for each run.

    Raises:
        ConfigError: where runs and controls don't belong together.
        MetricError: where too few frames are labeled, or all are.
    """
    opened = [open_folder(folder) for folder in runs]
    others = _group(opened, [open_folder(folder) for folder in controls])
    counts, labeled = zip(*(_count_labeled(run) for run in opened), strict=True)
    is_labeled = np.concatenate(labeled)
    if is_labeled.all():
        raise MetricError("every frame is labeled: controls are for frames without labels; see --intervals")
    agreement = [
        np.concatenate([_count_all(run, one[run.manifest.data_key]) for run in opened]) for one in others.values()
    ]
    found = np.concatenate(counts)
    return {metric: control(found, agreement, is_labeled, ratio) for metric, ratio in RATIOS["detection"].items()}


def _group(runs: Sequence[Run], controls: Sequence[Run]) -> dict[str, dict[str, Run]]:
    """Controls by pipeline and what they replayed."""
    found: dict[str, dict[str, Run]] = {}
    for one in controls:
        found.setdefault(one.manifest.pipeline, {})[one.manifest.data_key] = one
    for run in runs:
        for pipeline, own in found.items():
            if run.manifest.data_key not in own:
                raise ConfigError(f"--control: no run of '{pipeline}' is on the log of {run.folder}")
    return found


def _count_labeled(run: Run) -> tuple[Int64, Bool]:
    """Counts (n, 3) of labeled frames, and which of all frames those are."""
    frames = count_frames(run, options_of(run.scores))
    place = next((place for place in frames.counts if place[:3] == ("detection", "vehicle", "all")), None)
    if place is None:
        raise MetricError(f"{run.folder}: no frame has truth")
    return frames.counts[place], np.array([bool(frame.truth_spaces) for frame in run.frames])


def _count_all(run: Run, other: Run) -> Int64:
    counts, index = count_agreement(run, other)
    if len(index) != len(run.frames):
        raise ConfigError(f"--control {other.folder}: has other frames than {run.folder}")
    return counts
