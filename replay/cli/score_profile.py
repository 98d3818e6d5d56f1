"""Scoring a run by the rules of a benchmark."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fbench.replay.cli.coverage_gate import gated
from fbench.replay.cli.run_summary import open_run
from fbench.replay.cli.score_show import Told, show_scores
from fbench.replay.cli.score_wish import ProfileWish
from fbench.replay.errors import EXIT_LOSSY, EXIT_OK
from fbench.replay.store import Run

if TYPE_CHECKING:
    from fbench.metrics.profile import Match
    from fbench.metrics.profiles.catalog import AnyProfile
    from fbench.metrics.sequence import Sequence as Scored


def score_runs_by(runs: Sequence[Path], wish: ProfileWish, min_coverage: float) -> int:
    """Score runs by a profile, print the result, and return the exit code; the runs' own scores stay as they are.

    Raises:
        FbenchError: where they can't be scored.
    """
    from fbench.metrics.evaluate import evaluate
    from fbench.metrics.profile import Match
    from fbench.metrics.profiles.choose import chosen, only
    from fbench.metrics.profiles.of_run import fitted_to

    match = None if wish.match is None else Match.parse(wish.match)
    opened = [open_run(folder) for folder in runs]
    profile = fitted_to(opened[0], chosen(wish.profile, wish.match), match)
    found = evaluate(profile, (_sequence(run, profile, match) for run in opened))
    told = Told(", ".join(map(str, runs)), profile.name, tuple(found.statistics))
    show_scores(only(found.scores(wish.resampling.how()), wish.classes), told, wish)
    complete = all(run.manifest.complete for run in opened)
    code = EXIT_OK if complete else EXIT_LOSSY
    return gated(opened[0], min_coverage, code) if len(opened) == 1 else code


def _sequence(run: Run, profile: "AnyProfile", match: "Match | None") -> "Scored":
    from fbench.metrics.profiles.of_run import misses_classes, run_sequence

    sequence = run_sequence(run, profile, match)
    if misses_classes(sequence, profile):
        sys.stderr.write(
            f"{run.folder}: the results have no classes, so none of them is of a class of {profile.name}\n"
        )
    return sequence
