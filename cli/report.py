"""`fbench report`."""

from pathlib import Path
from typing import Annotated

import typer


def report(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="One or several run folders.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="The file; else report.html in the first RUN.")
    ] = None,
    kind: Annotated[str, typer.Option(help="Which report plug-in writes it.")] = "html",
) -> None:
    """Write one self-contained report of one or several runs."""
    from fbench.cli.run_summary import open_run
    from fbench.cli.show import console
    from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK
    from fbench.replay.contracts.plugins import load

    opened = [open_run(folder) for folder in runs]
    path = out or opened[0].folder / "report.html"
    load("reports", kind)().write(opened, path)
    console().print(f"report: {path}", markup=False, soft_wrap=True)
    raise typer.Exit(EXIT_OK if all(run.manifest.complete for run in opened) else EXIT_LOSSY)
