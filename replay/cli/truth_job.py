"""Labelling a run from a file on the command line."""

import sys
from collections.abc import Mapping

from fbench.replay.logs.setup import BoxSource
from fbench.replay.store import Run
from fbench.replay.truth.relabel import relabel


def label_run(run: Run, source: BoxSource, classes: Mapping[str, str], max_between_ns: int = 0) -> Run:
    """Replace the truth of a run, say on stderr how much of the file was used, and return the run as it is now."""
    found = relabel(run, source, classes, max_between_ns)
    labelled = f"{found.num_matched} of {run.manifest.num_frames} frames"
    labelled += f", {found.num_between} of them by interpolation" if found.num_between else ""
    sys.stderr.write(f"truth: {source.path.name} has {found.num_truths} instants and labels {labelled}\n")
    return Run(run.folder)
