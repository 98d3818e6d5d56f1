"""`fbench weights`: detectors for real images."""

from pathlib import Path
from typing import Annotated

import typer

from fbench.replay.cli import examples
from fbench.replay.cli.options import Json

app = typer.Typer(help="List and fetch camera detectors for real images.", no_args_is_help=True)


@app.command("list", epilog=examples.WEIGHTS_LIST)
def list_(json: Json = False) -> None:
    """List the detectors that fbench knows by name, and which of them are here; needs no network."""
    from fbench.pipelines.weights.catalogue import CATALOGUE
    from fbench.replay.cli.weights_job import show_weights

    show_weights(CATALOGUE, json)


@app.command("get", epilog=examples.WEIGHTS_GET)
def get(
    name: Annotated[str, typer.Argument(help="Which, such as deimv2-femto; see `fbench weights list`.")],
    file: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="Take in this file, fetched by hand, instead of downloading it."),
    ] = None,
) -> None:
    """Fetch a detector, check it against its published sha256, and keep it in fbench's cache."""
    from fbench.pipelines.weights.catalogue import entry_named
    from fbench.replay.cli.weights_job import get_weights

    get_weights(entry_named(name), file)
