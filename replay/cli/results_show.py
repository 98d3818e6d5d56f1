"""Tables of results on the terminal."""

from collections.abc import Iterable

from rich.console import Console
from rich.table import Table

from fbench.replay.result_table import Results, ResultTable, shown

_ON_TERMINAL = ("accuracy", "robustness", "latency")
"""The others are in the files."""


def show_results(results: Results, out: Console) -> None:
    """Print what ran, the main tables, and what went wrong."""
    for table in (*results.tables, *results.measured):
        if table.name in _ON_TERMINAL and table.lines and table.columns:
            _show(table, out)
    facts = dict(results.facts)
    _lines((f"{name}: {facts[name]}" for name in ("camera detector", "frames") if name in facts), out)
    _lines(results.problems, out)


def _show(table: ResultTable, out: Console) -> None:
    out.print(f"\n{table.title}", style="bold", markup=False)
    grid = Table(box=None, pad_edge=False)
    grid.add_column("")
    if table.has_spaces:
        grid.add_column("")
    for column in table.columns:
        grid.add_column(column.name, justify="right")
    for line in table.lines:
        names = (line.name, line.space) if table.has_spaces else (line.name,)
        cells = (shown(f.value, c.kind) for f, c in zip(line.figures, table.columns, strict=True))
        grid.add_row(*names, *cells)
    out.print(grid)
    if table.name != "latency":  # a stage that a pipeline hasn't needs no reason
        _lines((f"– {text}" for text in table.reasons), out)
    out.print()


def _lines(lines: Iterable[str], out: Console) -> None:
    for line in lines:
        out.print(line, markup=False, soft_wrap=True)
