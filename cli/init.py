"""`fbench init`."""

from pathlib import Path
from typing import Annotated

import typer

from fbench.cli.options import Json, Log


def init(
    log: Log,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="File to write; else fbench.toml beside the log.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing file.")] = False,
    json: Json = False,
) -> None:
    """Look at a log and write an fbench.toml that says what is in it, with the reasons."""
    from fbench.cli.init_job import run_init

    run_init(log, out, overwrite, json)
