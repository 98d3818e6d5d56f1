"""`fbench replay`."""

from pathlib import Path
from typing import Annotated

import typer

from fbench.replay.cli.detect_every import DetectEvery, with_detect_every
from fbench.replay.cli.log_options import (
    Config,
    DetectionsFile,
    PipelineOrFile,
    RigFiles,
    TruthFile,
    TruthFormat,
    TruthFrame,
)
from fbench.replay.cli.options import (
    DistanceM,
    Frames,
    From,
    InterpolateTruth,
    InView,
    Iou,
    Json,
    Log,
    MaxGapS,
    MinCoverage,
    NoMedia,
    Offset,
    Overwrite,
    RangeM,
    ReadAhead,
    Redact,
    Reference,
    Sensors,
    Settings,
    Stamps,
    TimeoutMs,
    To,
    ToleranceMs,
    Topics,
)  # fmt: skip


def replay(
    context: typer.Context,
    log: Log,
    pipeline: PipelineOrFile = None,
    settings: Settings = None,
    detect_every: DetectEvery = None,
    config: Config = None,
    rig: RigFiles = None,
    truth: TruthFile = None,
    truth_format: TruthFormat = None,
    truth_frame: TruthFrame = "",
    interpolate_truth: InterpolateTruth = 0.0,
    detections: DetectionsFile = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Run folder; else runs/LOG-PIPELINE.")] = None,
    overwrite: Overwrite = False,
    rate: Annotated[
        str, typer.Option(metavar="RATE", help="Pace: 'max', or a multiple of real time such as 0.5 or 10.")
    ] = "max",
    reference: Reference = None,
    timeout_ms: TimeoutMs = None,
    tolerance_ms: ToleranceMs = None,
    max_gap_s: MaxGapS = None,
    from_: From = None,
    to: To = None,
    frames: Frames = None,
    topics: Topics = None,
    sensors: Sensors = None,
    offset: Offset = None,
    stamps: Stamps = None,
    read_ahead: ReadAhead = "auto",
    on_fault: Annotated[
        str, typer.Option(metavar="HOW", help="'strict': lost data mean exit 4; 'tolerant': only counted.")
    ] = "strict",
    fault_budget: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[CODE=]N", help="So many faults that lose data are allowed, of one code or in all; repeatable."
        ),
    ] = None,
    range_m: RangeM = 50.0,
    in_view: InView = True,
    distance_m: DistanceM = 2.0,
    iou: Iou = 0.5,
    min_coverage: MinCoverage = 0.0,
    no_media: NoMedia = False,
    redact: Redact = False,
    report: Annotated[bool, typer.Option("--report", help="Write report.html into the run folder too.")] = False,
    json: Json = False,
) -> None:
    """Replay a log into a pipeline, score it, and write a run folder."""
    from fbench.replay.cli.coverage_gate import gated
    from fbench.replay.cli.job import Job, run_job
    from fbench.replay.cli.log_options import box_source, pipeline_of
    from fbench.replay.cli.run_summary import show_run
    from fbench.replay.config.source import LogWish, log_source
    from fbench.replay.errors import EXIT_LOSSY, EXIT_OK
    from fbench.replay.excerpt import make_excerpt
    from fbench.replay.fault_budget import parse_budget
    from fbench.replay.read_ahead import make_limit
    from fbench.replay.scores import ScoreOptions
    from fbench.replay.sensor_choice import make_sensors
    from fbench.replay.truth.times import make_max_between_ns

    filed = box_source(truth, truth_format, truth_frame)
    results = box_source(detections, None, truth_frame)
    source = log_source(LogWish(log, config, rig or [], filed, results, topics or []))
    name = pipeline_of(pipeline, results)
    job = Job(
        log=source,
        pipeline=name,
        settings=with_detect_every(name, settings or [], detect_every),
        sensors=make_sensors(sensors or []),
        out=out,
        overwrite=overwrite,
        rate=rate,
        sync=source.sync(reference, timeout_ms, tolerance_ms, max_gap_s),
        stamps=source.stamps(stamps, offset or []),
        excerpt=make_excerpt(from_, to, frames),
        max_between_ns=make_max_between_ns(interpolate_truth),
        read_ahead=make_limit(read_ahead),
        budget=parse_budget(on_fault, fault_budget or []),
        scoring=ScoreOptions(range_m, in_view, distance_m, iou),
        no_media=no_media,
        redact=redact,
        report=report,
        debug=bool(context.find_root().params["debug"]),
    )
    run = run_job(job)
    show_run(run, json)
    raise typer.Exit(gated(run, min_coverage, EXIT_OK if run.manifest.complete else EXIT_LOSSY))
