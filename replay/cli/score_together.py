"""`fbench score RUN RUN...`: several runs of one pipeline as one."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fbench.replay.cli.run_summary import open_run
from fbench.replay.cli.show import console, interval_reasons, null_reasons, print_json, score_table
from fbench.replay.errors import EXIT_LOSSY, EXIT_OK
from fbench.replay.scores import ScoreOptions, save_scores, score_rows

if TYPE_CHECKING:
    from fbench.metrics.statistics.bootstrap import Bootstrap


def score_together(
    runs: Sequence[Path], options: ScoreOptions, how: "Bootstrap | None", out: Path | None, as_json: bool
) -> int:
    """Score runs together, one in memory at a time; print the result, write it to `out`, and return the exit code.

    Raises:
        FbenchError: where a folder is no run, pipelines differ, or runs count different boxes.
    """
    from fbench.metrics.combine import combined, measure_run, told_of

    opened = [open_run(folder) for folder in runs]
    complete = all(run.manifest.complete for run in opened)
    measured = [measure_run(run, options) for run in opened]
    rows = combined(measured, how)
    for line in told_of(measured):
        sys.stderr.write(f"{line}\n")
    if out is not None:
        save_scores(out, rows)
    if as_json:
        print_json({"runs": [str(folder) for folder in runs], "scores": score_rows(rows)})
    else:
        shown = console()
        shown.print(f"{len(opened)} runs together", markup=False)
        shown.print(score_table(rows))
        for line in (*null_reasons(rows), *interval_reasons(rows)):
            shown.print(f"– {line}", markup=False)
    return EXIT_OK if complete else EXIT_LOSSY
