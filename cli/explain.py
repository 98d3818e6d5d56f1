"""Output of `fbench score RUN --explain FRAME`: every box of one frame, and what became of it."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table as Lines

from fbench.api.scores import open_folder
from fbench.cli.show import console, print_json
from fbench.replay.contracts.errors import EXIT_OK
from fbench.replay.data.scores import ScoreOptions

if TYPE_CHECKING:
    from fbench.metrics.explanation import Explanation, Table, Verdict

_OUTCOMES = ("missed", "false alarm", "invalid", "hit", "ignored")


def explain_run(run: Path, options: ScoreOptions, frame: int, class_: str, as_json: bool) -> int:
    """Print what became of each box of a frame, and return the exit code. Raises FbenchError where there is no such
    run, frame or class, or the frame isn't scored.
    """
    from fbench.metrics.explanation import explain_frame

    told = explain_frame(open_folder(run), options, frame, class_)
    if as_json:
        print_json(told.content())
    else:
        _show(told)
    return EXIT_OK


def _show(told: "Explanation") -> None:
    out = console()
    out.print(f"frame {told.frame} at {told.stamp_ns} ns, {told.class_}, {told.matching}", markup=False, soft_wrap=True)
    if told.num_invalid_truth:
        out.print(f"{told.num_invalid_truth} truth boxes aren't finite and were left out")
    for table in told.tables:
        out.print()
        out.print(_lines(table))
        left_out = Counter(row.reason.partition(":")[0] for row in table.truth if row.outcome == "ignored")
        if left_out:
            why = ", ".join(f"{num} {reason}" for reason, num in sorted(left_out.items()))
            out.print(f"truth that needn't be found: {why} (each of them with --json)", markup=False, soft_wrap=True)


def _lines(table: "Table") -> Lines:
    """What went wrong first."""
    rows = sorted((row for row in (*table.truth, *table.estimates) if row.side != "truth" or row.outcome != "ignored"),
                  key=lambda row: _OUTCOMES.index(row.outcome))  # fmt: skip
    cameras = any(row.camera for row in rows)
    lines = Lines(title=f"{table.judged}s", title_justify="left", box=None, pad_edge=False)
    for name in ("box", *(["camera"] if cameras else []), "class", "id", "score", "range", "outcome", "why"):
        lines.add_column(name, justify="right" if name in ("id", "score", "range") else "left")
    for row in rows:
        lines.add_row(*_cells(row, cameras))
    return lines


def _cells(row: "Verdict", cameras: bool) -> list[str]:
    return [
        f"{row.side} {row.number}", *([row.camera] if cameras else []), row.class_ or "–",
        "–" if row.track_id is None else str(row.track_id), "–" if row.score is None else f"{row.score:.2f}",
        "–" if row.range_m is None else f"{row.range_m:.1f} m", row.outcome, row.reason,
    ]  # fmt: skip
