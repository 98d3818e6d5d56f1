"""`fbench compare`."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from fbench.cli import options
from fbench.cli.show import console, make_table, number, print_json, say
from fbench.replay.contracts.errors import EXIT_NO, EXIT_OK

_STYLES = {"better": "green", "worse": "red", "gone": "red", "null": "yellow", "new": "cyan"}


def compare(
    base: Annotated[Path, Argument(metavar="BASE", help="The run to compare with.")],
    head: Annotated[Path, Argument(metavar="HEAD", help="The run that should not be worse.")],
    tolerance: Annotated[float, Option(min=0, help="Largest drop of a primary metric that passes.")] = 0.0,
    json: options.Json = False,
) -> None:
    """Print what changed between two runs; exit 1 when a primary metric fell by more than the tolerance."""
    from fbench.api.runs import compare as compare_runs

    found = compare_runs(base, head, tolerance)
    comparison = found.comparison
    if json:
        rows = [asdict(row) for row in comparison.rows]
        print_json({"regressed": found.is_worse, "tolerance": tolerance, "notes": found.notes, "rows": rows})
        raise typer.Exit(EXIT_NO if found.is_worse else EXIT_OK)
    say(*(f"note: {note}" for note in found.notes))
    columns = ("metric", "class", "slice", "matching", "base", "head", "change", "")
    table = make_table(*columns, right=("base", "head", "change"))
    num_empty = num_same = 0
    for row in comparison.rows:
        is_empty = row.base is None and row.head is None
        if row.primary or (row.verdict != "same" and not is_empty):
            delta = "–" if row.delta is None else f"{row.delta:+.3f}"
            verdict = f"{row.verdict}{' (primary)' if row.primary else ''}"
            cells = (number(row.metric, row.base, row.unit), number(row.metric, row.head, row.unit), delta)
            style = _STYLES.get(row.verdict)
            table.add_row(row.metric, row.class_, row.slice, row.matching, *cells, verdict, style=style)
        else:
            num_empty, num_same = num_empty + is_empty, num_same + (not is_empty)
    console().print(table)
    same = f"{num_same} other numbers are the same"
    say(f"{same}, {num_empty} have no value in either run" if num_empty else same)
    verdict = "REGRESSED: a primary metric fell" if comparison.is_worse else "no regression"
    say(f"{verdict} (tolerance {comparison.tolerance:g})")
    raise typer.Exit(EXIT_NO if found.is_worse else EXIT_OK)
