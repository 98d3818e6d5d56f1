"""What `fbench compare` prints."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from fbench.replay.cli.run_summary import open_run
from fbench.replay.cli.show import console, number, print_json
from fbench.replay.errors import EXIT_NO, EXIT_OK

if TYPE_CHECKING:
    from fbench.metrics.compare import Comparison

_MARKS = {"better": "green", "worse": "red", "gone": "red", "null": "yellow", "new": "cyan"}


def compare_runs(base: Path, head: Path, tolerance: float, as_json: bool) -> int:
    """Print what changed; returns the exit code."""
    from fbench.metrics.compare import compare, require_comparable

    before, after = open_run(base), open_run(head)
    notes = require_comparable(before.manifest, after.manifest)
    comparison = compare(before.scores, after.scores, tolerance)
    if as_json:
        rows = [asdict(row) for row in comparison.rows]
        content = {"regressed": comparison.regressed, "tolerance": tolerance, "notes": notes, "rows": rows}
        print_json(content)
    else:
        _print(comparison, notes)
    return EXIT_NO if comparison.regressed else EXIT_OK


def _print(comparison: "Comparison", notes: tuple[str, ...]) -> None:
    out = console()
    for note in notes:
        out.print(f"note: {note}", markup=False, soft_wrap=True)
    changed = [row for row in comparison.rows if row.verdict != "same" or row.primary]
    table = Table(box=None, pad_edge=False)
    for column in ("metric", "class", "matching", "base", "head", "change", ""):
        table.add_column(column, justify="right" if column in ("base", "head", "change") else "left")
    for row in changed:
        delta = "–" if row.delta is None else f"{row.delta:+.3f}"
        verdict = f"{row.verdict}{' (primary)' if row.primary else ''}"
        cells = (number(row.metric, row.base, row.unit), number(row.metric, row.head, row.unit), delta)
        table.add_row(row.metric, row.class_, row.matching, *cells, verdict, style=_MARKS.get(row.verdict))
    out.print(table)
    out.print(f"{len(comparison.rows) - len(changed)} other numbers are the same")
    verdict = "REGRESSED: a primary metric fell" if comparison.regressed else "no regression"
    out.print(f"{verdict} (tolerance {comparison.tolerance:g})")
