"""`fbench log ...`."""

from typing import Annotated

import typer

from fbench.replay.cli import examples, log_convert, log_export, log_import, log_preview, log_simulate
from fbench.replay.cli.log_options import Config, RigFiles, TruthFile, TruthFormat, TruthFrame
from fbench.replay.cli.options import (
    Json,
    Log,
    MaxGapS,
    Offset,
    Reference,
    Sensors,
    Settings,
    Stamps,
    TimeoutMs,
    ToleranceMs,
    Topics,
)

app = typer.Typer(help="Look into logs and make them.", no_args_is_help=True)


@app.command("info", epilog=examples.LOG_INFO)
def info(log: Log, config: Config = None, rig: RigFiles = None, json: Json = False) -> None:
    """Show what a log holds: topics, rates, duration, sensors, calibration, truth, segments."""
    from fbench.replay.cli.log_info import show_info
    from fbench.replay.config.source import LogWish, log_source

    raise typer.Exit(show_info(log_source(LogWish(log, config, rig or [])), json))


@app.command("check", epilog=examples.LOG_CHECK)
def check(
    log: Log,
    pipeline: Annotated[
        str | None, typer.Option("--pipeline", "-p", metavar="NAME", help="Say what this pipeline would miss too.")
    ] = None,
    settings: Settings = None,
    config: Config = None,
    rig: RigFiles = None,
    truth: TruthFile = None,
    truth_format: TruthFormat = None,
    truth_frame: TruthFrame = "",
    reference: Reference = None,
    timeout_ms: TimeoutMs = None,
    tolerance_ms: ToleranceMs = None,
    max_gap_s: MaxGapS = None,
    topics: Topics = None,
    sensors: Sensors = None,
    offset: Offset = None,
    stamps: Stamps = None,
    ignore: Annotated[
        list[str] | None, typer.Option(metavar="CODE", help="Show these findings as information only; repeatable.")
    ] = None,
    images: Annotated[bool, typer.Option("--images", help="Decode images whole, not only their headers.")] = False,
    json: Json = False,
) -> None:
    """Read a whole log and report what is wrong: exit 0 clean, 1 findings, 3 unreadable."""
    from fbench.replay.cli.log_check import CheckJob, run_check
    from fbench.replay.cli.log_options import box_source
    from fbench.replay.config.source import LogWish, log_source
    from fbench.replay.sensor_choice import make_sensors

    filed = box_source(truth, truth_format, truth_frame)
    source = log_source(LogWish(log, config, rig or [], filed, None, topics or []))
    job = CheckJob(
        log=source,
        pipeline=pipeline,
        settings=settings or [],
        sensors=make_sensors(sensors or []),
        sync=source.sync(reference, timeout_ms, tolerance_ms, max_gap_s),
        stamps=source.stamps(stamps, offset or []),
        ignored=ignore or [],
        decode_images=images,
        as_json=json,
    )
    raise typer.Exit(run_check(job))


app.command("preview", epilog=examples.LOG_PREVIEW)(log_preview.preview)
app.command("convert", epilog=examples.LOG_CONVERT)(log_convert.convert)


app.command("import", epilog=examples.LOG_IMPORT)(log_import.import_)
app.command("export", epilog=examples.LOG_EXPORT)(log_export.export)
app.command("simulate", epilog=examples.LOG_SIMULATE)(log_simulate.simulate)
