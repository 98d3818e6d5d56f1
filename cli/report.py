"""`fbench report`."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option


def report(
    runs: Annotated[list[Path], Argument(metavar="RUN...", help="One or more run folders.")],
    out: Annotated[
        Path | None, Option("--out", "-o", help="The report (default: report.html in the first RUN).")
    ] = None,
    kind: Annotated[str, Option(help="Report plug-in to use.")] = "html",
) -> None:
    """Write one self-contained report of one or several runs."""
    from fbench.api.runs import open_run
    from fbench.api.runs import report as write_report
    from fbench.cli.show import console
    from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK

    path = write_report(runs, out, kind)
    console().print(f"report: {path}", markup=False, soft_wrap=True)
    raise typer.Exit(EXIT_OK if all(open_run(folder).complete for folder in runs) else EXIT_LOSSY)
