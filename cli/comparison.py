"""Output of `fbench compare`."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from fbench.api.runs import compare
from fbench.cli.show import console, number, print_json
from fbench.replay.contracts.errors import EXIT_NO, EXIT_OK

if TYPE_CHECKING:
    from fbench.metrics.comparison import Comparison, Row

_MARKS = {"better": "green", "worse": "red", "gone": "red", "null": "yellow", "new": "cyan"}


def compare_runs(base: Path, head: Path, tolerance: float, as_json: bool) -> int:
    """Print what changed; returns the exit code."""
    found = compare(base, head, tolerance)
    comparison, notes = found.comparison, found.notes
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
    changed = [row for row in comparison.rows if row.primary or (row.verdict != "same" and not _is_empty(row))]
    num_empty = sum(_is_empty(row) and not row.primary for row in comparison.rows)
    table = Table(box=None, pad_edge=False)
    for column in ("metric", "class", "slice", "matching", "base", "head", "change", ""):
        table.add_column(column, justify="right" if column in ("base", "head", "change") else "left")
    for row in changed:
        delta = "–" if row.delta is None else f"{row.delta:+.3f}"
        verdict = f"{row.verdict}{' (primary)' if row.primary else ''}"
        cells = (number(row.metric, row.base, row.unit), number(row.metric, row.head, row.unit), delta)
        table.add_row(row.metric, row.class_, row.slice, row.matching, *cells, verdict, style=_MARKS.get(row.verdict))
    out.print(table)
    same = f"{len(comparison.rows) - len(changed) - num_empty} other numbers are the same"
    out.print(f"{same}, {num_empty} have no value in either run" if num_empty else same)
    verdict = "REGRESSED: a primary metric fell" if comparison.regressed else "no regression"
    out.print(f"{verdict} (tolerance {comparison.tolerance:g})")


def _is_empty(row: "Row") -> bool:
    """Whether a number is undefined in both runs, so that it says nothing."""
    return row.base is None and row.head is None
