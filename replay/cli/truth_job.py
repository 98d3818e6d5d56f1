"""Labelling a run from a file on the command line."""

import sys
from collections.abc import Mapping

from fbench.replay.logs.setup import BoxSource
from fbench.replay.relabel import relabel
from fbench.replay.store import Run


def label_run(run: Run, source: BoxSource, classes: Mapping[str, str]) -> Run:
    """Replace the truth of a run, say on stderr how much of the file was used, and return the run as it is now."""
    found = relabel(run, source, classes)
    labelled = f"{found.num_matched} of {run.manifest.num_frames} frames"
    sys.stderr.write(f"truth: {source.path.name} has {found.num_truths} instants and labels {labelled}\n")
    return Run(run.folder)
