"""`fbench bench`: suites of logs, pipelines, conditions, rates and seeds from a file."""

import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text
from typer import Argument, Option
from typer.core import TyperGroup

from fbench.cli import options
from fbench.cli.options import examples
from fbench.cli.progress import import_progress
from fbench.cli.show import make_table, print_json, printable, say, show_results
from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK, ConfigError

if TYPE_CHECKING:
    from fbench.api.suites.bench import BenchResult
    from fbench.api.suites.cells import CellResult
    from fbench.api.suites.suite import SuiteCell


class _RunsByDefault(TyperGroup):
    """`fbench bench SUITE.toml` is `fbench bench run SUITE.toml`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Say `run` where no command is named."""
        if args and args[0] not in (*self.commands, "--help"):
            args = ["run", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_RunsByDefault, no_args_is_help=True, rich_markup_mode="rich", epilog=examples("bench"),
    help="Run suites: logs x pipelines x conditions x rates x seeds. [bold]fbench bench SUITE.toml[/bold] runs one; "
    "[bold]fbench bench init LOG...[/bold] writes one. Options, such as --jobs, --out, and --scheduler: "
    "[bold]fbench bench run --help[/bold].",
)  # fmt: skip


@app.command("run", epilog=examples("bench"))
def run(
    suite: Annotated[Path, Argument(metavar="SUITE.toml", help="The suite file.", show_default=False)],
    out: Annotated[
        Path | None, Option("--out", "-o", help="Folder for runs and tables (default: runs/NAME).", show_default=False)
    ] = None,
    jobs: options.Jobs = None,
    device: options.Device = "cpu",
    scheduler: Annotated[
        str, Option(metavar="ADDRESS", help="Dask scheduler whose workers run the cells, such as tcp://host:8786.")
    ] = "",
    store: Annotated[
        str, Option(metavar="URL", help="Folder or URL that keeps runs by content, for workers without a shared disk.")
    ] = "",
    leave_one_out: Annotated[
        bool, Option("--leave-one-out", help="Also run each pipeline without each of its sensors.")
    ] = False,
    json: options.Json = False,
) -> None:
    """Run the cells of a suite whose runs aren't there, and print what they gave."""
    from fbench.api.suites.bench import BenchRequest, run_bench

    request = BenchRequest(suite, out, jobs, scheduler, store, device, leave_one_out)
    table = SuiteProgress()
    try:
        with import_progress(1) as simulated:
            result = run_bench(
                request, simulated, table.note_result, lambda: say("waiting for another fbench bench in this folder"),
                lambda cells: _watch(table, simulated.hide(), cells),
            )  # fmt: skip
    except KeyboardInterrupt:
        sys.stderr.write("fbench: interrupted; finished work is kept, and the same command continues from there\n")
        raise
    paths = _write(result)
    if json:
        print_json(_content(result))
    else:
        show_results(result.results)
        states = Counter(found.state for _, found in result.cells)
        whole = f"{states['there'] + states['replayed']} of {len(result.cells)}"
        say(f"cells: {whole} ({states['replayed']} replayed, {states['there']} there already, {states['unfit']} unfit, "
            f"{states['failed']} failed)")  # fmt: skip
        say(*(f"{path.stem}: {path}" for path in paths))
    raise typer.Exit(EXIT_LOSSY if any(found.state == "failed" for _, found in result.cells) else EXIT_OK)


@contextmanager
def _watch(
    table: "SuiteProgress", hidden: AbstractContextManager[None], cells: Sequence["SuiteCell"]
) -> Iterator[None]:
    with hidden, table.show(len(cells)):
        yield


class SuiteProgress:
    """Progress of a suite, time left, and failures: a live table on a terminal, lines otherwise."""

    _TENTHS = 10
    _MOST_FAILURES = 5
    _NARROW = 70  # Columns that the table needs

    def __init__(self) -> None:
        self._console = Console(file=sys.stderr)
        self._states: Counter[str] = Counter()
        self._failures: list[str] = []
        self._total, self._shown, self._start = 0, 0, time.monotonic()
        self._live: Live | None = None

    @contextmanager
    def show(self, total: int) -> Iterator[None]:
        """Show the progress while the `with` block runs."""
        self._total, self._start = total, time.monotonic()
        if not self._console.is_terminal or self._console.is_dumb_terminal:
            yield
            return
        with Live(self._table(), console=self._console, transient=True, refresh_per_second=4) as self._live:
            yield
        self._live = None

    def note_result(self, cell: "SuiteCell", result: "CellResult") -> None:
        """Note what became of a cell."""
        self._states[result.state] += 1
        if result.state == "failed":
            line = f"failed: {cell.pipeline} on {cell.log}, {cell.condition}: {result.reason}"
            self._failures.append(printable(line))
            if self._live is None:
                sys.stderr.write(f"{self._failures[-1]}\n")
        num = self._states.total()
        if self._live is not None:
            self._live.update(self._table())
        elif num * self._TENTHS // self._total > self._shown and num < self._total:
            self._shown = num * self._TENTHS // self._total
            sys.stderr.write(f"{num} of {self._total} cells{self._left()}\n")

    def _left(self) -> str:
        """The time that is left, as what was replayed so far tells."""
        num_run = self._states["replayed"] + self._states["failed"]
        if not num_run:
            return ""
        left = (self._total - self._states.total()) * (time.monotonic() - self._start) / num_run
        return f", about {_duration(left)} left"

    def _table(self) -> Table:
        states, elapsed = self._states, _duration(time.monotonic() - self._start)
        done, left = f"{states.total()} of {self._total}", self._left()
        style = "red" if states["failed"] else None
        counts = {name: str(states[name]) for name in ("replayed", "there", "unfit", "failed")}
        outer = Table.grid()
        if self._console.width < self._NARROW:
            shown = ", ".join(f"{num} {name}" for name, num in counts.items() if num != "0")
            outer.add_row(Text(f"{done} cells in {elapsed}{left}: {shown or 'none done'}", style or ""))
        else:
            table = make_table("cells", *counts, "elapsed", "")
            table.add_row(done, *counts.values(), elapsed, left.removeprefix(", "), style=style)
            outer.add_row(table)
        for line in self._failures[-self._MOST_FAILURES :]:
            outer.add_row(Text(line))
        return outer


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"


def _content(result: "BenchResult") -> dict[str, object]:
    from fbench.api.suites.tables import cell_row
    from fbench.replay.data.scores import table_rows

    cells = [cell_row(result.suite.folder, cell, found) for cell, found in result.cells]
    tables = {table.name: table_rows(table) for table in result.results.tables}
    problems = list(result.results.problems)
    return {"facts": dict(result.results.facts), "tables": tables, "problems": problems, "cells": cells}


def _write(result: "BenchResult") -> list[Path]:
    from fbench.api.suites.bench import SUITE
    from fbench.api.suites.cells import CELLS, SCORES
    from fbench.replay.data.files import replace_text
    from fbench.replay.runs.folder import Run
    from fbench.reports.html.page import HtmlReport
    from fbench.reports.markdown import markdown

    folder = result.suite.folder
    replace_text(folder / "results.md", markdown(result.results))
    paths = [folder / name for name in (SUITE, CELLS, SCORES, "results.md")]
    done = [(cell, found) for cell, found in result.cells if found.has_run]
    if not done:
        return paths
    first = done[0][0]
    shown = [
        Run(found.folder) for cell, found in done
        if (cell.log, cell.condition, cell.rate, cell.seed) == (first.log, first.condition, first.rate, first.seed)
    ]  # fmt: skip
    HtmlReport().write_results(result.results, shown, folder / "report.html")
    return [*paths, folder / "report.html"]


@app.command("init", epilog=examples("bench init"))
def init(
    logs: Annotated[list[str], Argument(metavar="LOG...", help="Logs, patterns or URLs.", show_default=False)],
    pipelines: Annotated[
        list[str] | None, Option("--pipeline", "-p", metavar="NAME[,NAME]", help="Pipelines (default: by sensors).")
    ] = None,
    condition: Annotated[
        list[str] | None, Option(metavar="NAME[:LEVEL]", help="Conditions (default: clear); repeatable.")
    ] = None,
    out: Annotated[Path, Option("--out", "-o", metavar="FILE", help="The suite file.")] = Path("suite.toml"),
    overwrite: Annotated[bool, Option("--overwrite", help="Replace an existing file.")] = False,
) -> None:
    """Write a suite file for logs, with comments, ready to run."""
    from fbench.api.suites.template import write_suite

    if out.exists() and not overwrite:
        raise ConfigError(f"{out}: exists already; choose another with --out, or --overwrite it")
    names = [name.strip() for text in pipelines or () for name in text.split(",")]
    num = write_suite(out, logs, names, condition or ())
    say(f"suite: {out} ({num} cells)", f"run it: fbench bench {out}")
