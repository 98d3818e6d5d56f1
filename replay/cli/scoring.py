"""Scoring a run folder: every metric plug-in, and the latencies."""

import json
from pathlib import Path

from fbench.replay.files import replace_text
from fbench.replay.plugins import found, load
from fbench.replay.scores import ScoreOptions, save_scores
from fbench.replay.store import Run


def score_folder(folder: Path, options: ScoreOptions) -> Run:
    """Write `scores.json` and `latency.json` into a run folder and return the run."""
    from fbench.metrics.latency import summarise
    from fbench.metrics.score import score_run

    run = Run(folder)
    metrics = [load("metrics", name)() for name in found("metrics")]
    scores = score_run(run, options, metrics)
    latency = json.dumps(summarise(run.timings, run.clock), indent=1, allow_nan=False) + "\n"
    save_scores(folder / "scores.json", scores)
    replace_text(folder / "latency.json", latency)
    return Run(folder)
