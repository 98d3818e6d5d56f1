"""Scoring a run by the rules of a benchmark."""

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fbench.replay.cli.coverage_gate import gated
from fbench.replay.cli.run_summary import open_run
from fbench.replay.cli.score_again import require_truth
from fbench.replay.cli.score_show import Told, show_scores
from fbench.replay.cli.score_wish import ProfileWish
from fbench.replay.errors import EXIT_LOSSY, EXIT_OK
from fbench.replay.scores import Score
from fbench.replay.store import Run

if TYPE_CHECKING:
    from fbench.metrics.profile import Match
    from fbench.metrics.profiles.catalog import AnyProfile


def score_runs_by(runs: Sequence[Path], wish: ProfileWish, min_coverage: float) -> int:
    """Score runs by a profile, print the result, and return the exit code; the runs' own scores stay as they are.

    Raises:
        FbenchError: where they can't be scored.
    """
    from fbench.metrics.profile import Match
    from fbench.metrics.profiles.choose import chosen, only
    from fbench.metrics.profiles.default import DefaultProfile

    match = None if wish.match is None else Match.parse(wish.match)
    opened, profile = [open_run(folder) for folder in runs], chosen(wish.profile, wish.match)
    is_own = isinstance(profile, DefaultProfile)
    rows, sequences = _own(opened, match, wish) if is_own else _by(profile, opened, match, wish)
    show_scores(only(rows, wish.classes), Told(_named(runs), profile.name, sequences), wish)
    complete = all(run.manifest.complete for run in opened)
    code = EXIT_OK if complete else EXIT_LOSSY
    return gated(opened[0], min_coverage, code) if len(opened) == 1 else code


def _own(runs: Sequence[Run], match: "Match | None", wish: ProfileWish) -> tuple[list[Score], tuple[str, ...]]:
    """What the runs' own scores say."""
    from fbench.metrics.profiles.own import own_rows

    for run in runs:
        require_truth(run)
    rows, lines = own_rows(runs, match, wish.resampling.how())
    _say(lines)
    return rows, ()


def _by(
    profile: "AnyProfile", runs: Sequence[Run], match: "Match | None", wish: ProfileWish
) -> tuple[list[Score], tuple[str, ...]]:
    """What a benchmark says, and the names of its sequences."""
    from fbench.metrics.evaluate import evaluate
    from fbench.metrics.profiles.of_run import run_sequence
    from fbench.metrics.profiles.remarks import Remarks

    remarks = Remarks(profile, _named([run.folder for run in runs]))
    found = evaluate(profile, remarks.watched(run_sequence(run, profile, match) for run in runs))
    remarks.require_tracks()
    _say(remarks.lines())
    return found.scores(wish.resampling.how()), tuple(found.statistics)


def _named(runs: Iterable[Path]) -> str:
    return ", ".join(map(str, runs))


def _say(lines: Iterable[str]) -> None:
    for line in lines:
        sys.stderr.write(f"{line}\n")
