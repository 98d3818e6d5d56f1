"""`fbench log ...`."""

from pathlib import Path
from typing import Annotated

import typer

from fbench.replay.cli import examples, log_convert
from fbench.replay.cli.options import Json, Log, Offset, Stamps, Topics

app = typer.Typer(help="Look into logs and make them.", no_args_is_help=True)


@app.command("info", epilog=examples.LOG_INFO)
def info(log: Log, json: Json = False) -> None:
    """Show what a log holds: topics, rates, duration, sensors, calibration, truth, segments."""
    from fbench.replay.cli.log_info import show_info

    raise typer.Exit(show_info(log, json))


@app.command("check", epilog=examples.LOG_CHECK)
def check(
    log: Log,
    pipeline: Annotated[
        str | None, typer.Option("--pipeline", "-p", help="Say what this pipeline would miss too.")
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Change a parameter; may be repeated.")
    ] = None,
    reference: Annotated[str | None, typer.Option(help="Sensor whose stamps are the frames' instants.")] = None,
    timeout_ms: Annotated[float, typer.Option(min=0, help="How long a frame waits for its sensors, in ms.")] = 30.0,
    tolerance_ms: Annotated[float, typer.Option(min=0, help="How far stamps may lie from the instant, in ms.")] = 50.0,
    max_gap_s: Annotated[float, typer.Option(min=0, help="A longer pause is a gap, in s.")] = 2.0,
    topics: Topics = None,
    offset: Offset = None,
    stamps: Stamps = "header",
    ignore: Annotated[
        list[str] | None, typer.Option(metavar="CODE", help="Show these findings as information only.")
    ] = None,
    images: Annotated[bool, typer.Option("--images", help="Decode images whole, not only their headers.")] = False,
    json: Json = False,
) -> None:
    """Read a whole log and report what is wrong: exit 0 clean, 1 findings, 3 unreadable."""
    from fbench.replay.cli.job import to_ns
    from fbench.replay.cli.log_check import CheckJob, run_check
    from fbench.replay.restamp import make_stamp_params
    from fbench.replay.sync import SyncParams

    job = CheckJob(
        log=log,
        pipeline=pipeline,
        settings=settings or [],
        sync=SyncParams(reference, to_ns(timeout_ms, 1e6), to_ns(tolerance_ms, 1e6), to_ns(max_gap_s, 1e9)),
        stamps=make_stamp_params(stamps, offset or []),
        topics=topics or [],
        ignored=ignore or [],
        decode_images=images,
        as_json=json,
    )
    raise typer.Exit(run_check(job))


app.command("convert", epilog=examples.LOG_CONVERT)(log_convert.convert)


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
