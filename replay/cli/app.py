"""The commands of `fbench`, and how their errors become one line and an exit code."""

import os
import sys
from typing import Annotated

import typer

from fbench.replay.cli import compare, demo, log, plugins, replay, report, score
from fbench.replay.errors import FbenchError

app = typer.Typer(
    name="fbench",
    help="Replay recorded sensor logs into perception pipelines, and measure them.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode="rich",
)
app.command("demo")(demo.demo)
app.command("replay")(replay.replay)
app.command("score")(score.score)
app.command("report")(report.report)
app.command("compare")(compare.compare)
app.command("plugins")(plugins.plugins)
app.add_typer(log.app, name="log")


@app.callback()
def options(debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False) -> None:
    """Replay recorded sensor logs into perception pipelines, and measure them."""
    del debug  # read by `main`, before any command runs


def main() -> None:
    """Run the command line; foreseen errors become one line on stderr and an exit code."""
    # One BLAS thread, so that sums never depend on the number of cores; must be set before numpy is imported.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    try:
        app()
    except FbenchError as error:
        if "--debug" in sys.argv[1:2]:
            raise
        sys.stderr.write(f"fbench: {error}\n")
        sys.exit(error.exit_code)
