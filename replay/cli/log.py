"""`fbench log ...`."""

from pathlib import Path
from typing import Annotated

import typer

from fbench.replay.cli import examples, log_convert
from fbench.replay.cli.options import (
    Json,
    Log,
    MaxGapS,
    Offset,
    Reference,
    Settings,
    Stamps,
    TimeoutMs,
    ToleranceMs,
    Topics,
)

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
        str | None, typer.Option("--pipeline", "-p", metavar="NAME", help="Say what this pipeline would miss too.")
    ] = None,
    settings: Settings = None,
    reference: Reference = None,
    timeout_ms: TimeoutMs = 30.0,
    tolerance_ms: ToleranceMs = 50.0,
    max_gap_s: MaxGapS = 2.0,
    topics: Topics = None,
    offset: Offset = None,
    stamps: Stamps = "header",
    ignore: Annotated[
        list[str] | None, typer.Option(metavar="CODE", help="Show these findings as information only; repeatable.")
    ] = None,
    images: Annotated[bool, typer.Option("--images", help="Decode images whole, not only their headers.")] = False,
    json: Json = False,
) -> None:
    """Read a whole log and report what is wrong: exit 0 clean, 1 findings, 3 unreadable."""
    from fbench.replay.cli.log_check import CheckJob, run_check
    from fbench.replay.restamp import make_stamp_params
    from fbench.replay.sync import make_sync_params

    job = CheckJob(
        log=log,
        pipeline=pipeline,
        settings=settings or [],
        sync=make_sync_params(reference, timeout_ms, tolerance_ms, max_gap_s),
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
    out: Annotated[Path, typer.Option("--out", "-o", help="The log to write: FILE.mcap, or FOLDER.parquet.")],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing file.")] = False,
) -> None:
    """Turn a public dataset into an fbench log."""
    from fbench.replay.cli.import_job import import_log
    from fbench.replay.cli.show import console
    from fbench.replay.plugins import load

    importer = load("datasets", dataset)()
    printer = console()
    for line in import_log(importer, source, out, overwrite):
        printer.print(line, markup=False, soft_wrap=True)
    printer.print(f"log: {out}", markup=False, soft_wrap=True)
