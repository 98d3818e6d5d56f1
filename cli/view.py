"""`fbench view`."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option


def view(
    runs: Annotated[
        list[Path], Argument(metavar="RUN...", help="One or more run folders, or a folder with a report.html.")
    ],
    port: Annotated[int, Option(metavar="PORT", help="Port on localhost; 0: any that is free.")] = 0,
) -> None:
    """Serve the report of runs on this machine alone until Ctrl-C."""
    from fbench.api.reports import render
    from fbench.cli.show import say
    from fbench.reports.serve import open_server, url_of

    with open_server(render(runs), port) as server:
        say(f"report: {url_of(server)} (Ctrl-C ends)")
        server.serve_forever()
