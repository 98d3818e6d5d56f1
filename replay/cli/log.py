"""`fbench log ...`."""

from pathlib import Path
from typing import Annotated

import typer

from fbench.replay.cli import examples
from fbench.replay.cli.options import Json, Log

app = typer.Typer(help="Look into logs and make them.", no_args_is_help=True)


@app.command("info", epilog=examples.LOG_INFO)
def info(log: Log, json: Json = False) -> None:
    """Show what a log holds: topics, rates, duration, sensors, calibration, truth, segments."""
    from fbench.replay.cli.log_info import show_info

    raise typer.Exit(show_info(log, json))


@app.command("import", epilog=examples.LOG_IMPORT)
def import_(
    dataset: Annotated[str, typer.Argument(help="Which importer, such as astyx.")],
    source: Annotated[Path, typer.Argument(metavar="SRC", help="The dataset's folder.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The log to write, such as log.mcap.")],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing file.")] = False,
) -> None:
    """Turn a public dataset into an fbench log."""
    from fbench.replay.cli.show import console
    from fbench.replay.errors import ConfigError
    from fbench.replay.plugins import load

    importer = load("datasets", dataset)()
    if out.exists() and not overwrite:
        raise ConfigError(f"{out}: exists already; choose another with --out, or --overwrite it")
    printer = console()
    for line in importer.convert(source, out):
        printer.print(line, markup=False, soft_wrap=True)
    printer.print(f"log: {out}", markup=False, soft_wrap=True)
