"""Scoring of a run folder: every metric plug-in, and the latencies."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

from fbench.replay.contracts.plugins import found, load
from fbench.replay.data.files import replace_text
from fbench.replay.data.scores import ScoreOptions, save_scores
from fbench.replay.runs.folder import Run

if TYPE_CHECKING:
    from fbench.metrics.core.bootstrap import Bootstrap


def score_folder(folder: Path, options: ScoreOptions, how: "Bootstrap | None" = None) -> Run:
    """Write `scores.json` and `latency.json` into a run folder and return the run.

    Args:
        folder: Of the run.
        options: How boxes match, and which count.
        how: Resamples for confidence intervals of the scores; none by default.
    """
    from fbench.metrics.latency import summarise
    from fbench.metrics.runs.combine import score_run

    run = Run(folder)
    metrics = [load("metrics", name)() for name in found("metrics")]
    scores = score_run(run, options, metrics)
    if how is not None:
        from fbench.metrics.runs.scoring import intervals_of_run

        scores = intervals_of_run(run, options, scores, how)
    latency = json.dumps(summarise(run.timings, run.clock), indent=1, allow_nan=False) + "\n"
    save_scores(folder / "scores.json", scores)
    replace_text(folder / "latency.json", latency)
    return Run(folder)
