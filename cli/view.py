"""`fbench view`."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option


def view(
    runs: Annotated[
        list[Path], Argument(metavar="RUN...", help="One or more run folders, or a folder with a report.html.")
    ],
    port: Annotated[int, Option(metavar="PORT", help="Port on localhost; 0: any that is free.")] = 0,
    rerun: Annotated[bool, Option("--rerun", help="Open one RUN in the viewer of Rerun instead.")] = False,
) -> None:
    """Serve the report of runs on this machine alone until Ctrl-C, or show one in Rerun."""
    from fbench.api.reports import render, show_in_rerun
    from fbench.cli.show import say
    from fbench.replay.contracts.errors import ConfigError
    from fbench.reports.serve import open_server, url_of

    if rerun:
        if len(runs) > 1 or port:
            raise ConfigError("--rerun shows one RUN, and serves nothing")
        return show_in_rerun(runs[0])
    with open_server(render(runs), port) as server:
        say(f"report: {url_of(server)} (Ctrl-C ends)")
        return server.serve_forever()
