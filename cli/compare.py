"""`fbench compare`."""

import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Argument, Option

from fbench.cli import options
from fbench.cli.show import console, make_table, number, print_json, say
from fbench.replay.contracts.errors import EXIT_NO, EXIT_OK, ConfigError

if TYPE_CHECKING:
    from fbench.replay.data.comparison import Comparison, Row

_STYLES = {
    "improved": "green", "REGRESSED": "red", "gone": "red", "null": "yellow", "INCONCLUSIVE": "yellow", "new": "cyan",
}  # fmt: skip
_MOST_LINES = 12
_SIGNS = {True: "MORE CRITICAL ERRORS", False: "fewer critical errors"}
Reference = Annotated[
    Literal["truth", "base"], Option(help="'base': without labels, the results of BASE stand for truth.")
]
Write = Annotated[
    list[str] | None,
    Option(
        metavar="FORMAT=FILE",
        help="Also write it for CI: junit, markdown, github, gitlab, bmf, benchmark-json, json. Repeatable.",
    ),
]


def compare(
    base: Annotated[Path, Argument(metavar="BASE", help="Run, suite, or baseline file to compare with.")],
    head: Annotated[Path, Argument(metavar="HEAD", help="The run or suite that should not be worse.")],
    tolerance: Annotated[float | None, Option(min=0, help="Largest drop of F1 and MOTA that passes.")] = None,
    policy: Annotated[Path | None, Option(metavar="FILE", help="gate.toml: what gates, and by which rules.")] = None,
    reference: Reference = "truth",
    write: Write = None,
    link: Annotated[
        str | None, Option(metavar="URL", help="Address of the CI job, for the comment of markdown and github.")
    ] = None,
    report: Annotated[
        Path | None, Option(metavar="FILE.html", help="Also write a page: what changed, object by object.")
    ] = None,
    json: options.Json = False,
) -> None:
    """Print what changed between two runs or suites; exit 1 when the gate fails."""
    from fbench.api.reports import comparison as write_report
    from fbench.api.runs import compare as compare_runs
    from fbench.reports.ci import check_link, parse_target, write_comparison

    if tolerance is not None and policy is not None:
        raise ConfigError("--tolerance goes without --policy, which has a tolerance for each gate")
    url = check_link(link) if link else ""
    targets = [parse_target(text) for text in write or ()]
    if url and not any(kind in ("markdown", "github") for kind, _ in targets):
        raise ConfigError("--link: is for a comment; give --write markdown=FILE or github=FILE")
    comparison = compare_runs(base, head, tolerance or 0.0, policy, reference).comparison
    for kind, path in targets:
        sys.stderr.writelines(f"{line}\n" for line in write_comparison(comparison, kind, path, url))
    if report is not None:
        sys.stderr.write(f"report: {write_report(comparison, base, head, report)}\n")
    if json:
        print_json(comparison.content())
    else:
        _show(comparison)
    raise typer.Exit(EXIT_NO if comparison.is_worse else EXIT_OK)


def _show(comparison: "Comparison") -> None:
    say(*(f"note: {note}" for note in comparison.notes))
    from fbench.replay.data.boxes import VEHICLES  # numpy takes a while to import

    # Of single kinds of vehicles a wrong label makes an error, too.
    rows = (row for row in comparison.rows if row.class_ not in VEHICLES)
    critical = [row for row in rows if row.metric.startswith("critical_") and row.delta]
    say(*(f"{_SIGNS[(row.delta or 0) > 0]}: {row.name}: {row.values}" for row in critical if row.slice == "all"))
    names = {(row.pipeline, row.condition) for row in comparison.rows}
    cells = ("pipeline", "condition") if len(names) > 1 else ()
    columns = (*cells, "metric", "class", "slice", "matching", "base", "head", "change", "95 %", "shows", "verdict")
    table = make_table(*columns, right=("base", "head", "change", "95 %", "shows"))
    shown = [row for row in comparison.rows if row.gate or row.verdict in ("improved", "REGRESSED", "changed", "gone")]
    shown.sort(key=lambda row: not row.metric.startswith("critical_"))  # What can cause a collision comes first
    for row in shown:
        table.add_row(*((row.pipeline, row.condition) if cells else ()), *_cells(row), style=_STYLES.get(row.verdict))
    console().print(table)
    others = [row for row in comparison.rows if not row.gate and row not in shown]
    empty = sum(row.base is None and row.head is None for row in others)
    counts = Counter(row.verdict for row in others if row.base is not None or row.head is not None)
    parts = [f"{num} {verdict}" for verdict, num in counts.items()]
    say(f"other numbers: {', '.join([*parts, f'{empty} have no value in either run'])}")
    say(*(f"first difference: {found.cell}: {found}" for found in comparison.divergences[:_MOST_LINES]))
    places = comparison.places
    say(*(f"{places[change.cell]}{change}" for change in comparison.objects[:_MOST_LINES]))
    if (more := len(comparison.objects) - _MOST_LINES) > 0:
        say(f"... {more} more changes of objects, see --json")
    for frame in comparison.worst[:3]:
        say(f"{places[frame.cell]}worst {frame}")
    say(*(f"failed: {failure}" for failure in comparison.failures))
    say(*(f"{row.verdict}: {row.name}: {row.reason} ({row.gate})" for row in comparison.gating))
    say(comparison.headline)


def _cells(row: "Row") -> tuple[str, ...]:
    interval = "" if row.low is None or row.high is None else f"{row.low:+.3f} to {row.high:+.3f}"
    delta = "–" if row.delta is None else f"{row.delta:+.3f}"
    smallest = "" if row.smallest is None else f"{row.smallest:.3f}"
    verdict = f"{row.verdict}{' (gate)' if row.gate else ''}"
    values = number(row.metric, row.base, row.unit), number(row.metric, row.head, row.unit)
    return row.metric, row.class_, row.slice, row.matching, *values, delta, interval, smallest, verdict
