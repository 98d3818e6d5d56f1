"""`fbench replay`."""

from pathlib import Path
from typing import Annotated

import typer

from fbench.replay.cli.options import (
    DistanceM,
    Frames,
    From,
    InView,
    Iou,
    Json,
    Log,
    MaxGapS,
    Offset,
    Overwrite,
    Pipeline,
    RangeM,
    ReadAhead,
    Reference,
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
    pipeline: Pipeline,
    settings: Settings = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Run folder; else runs/LOG-PIPELINE.")] = None,
    overwrite: Overwrite = False,
    rate: Annotated[
        str, typer.Option(metavar="RATE", help="Pace: 'max', or a multiple of real time such as 0.5 or 10.")
    ] = "max",
    reference: Reference = None,
    timeout_ms: TimeoutMs = 30.0,
    tolerance_ms: ToleranceMs = 50.0,
    max_gap_s: MaxGapS = 2.0,
    from_: From = None,
    to: To = None,
    frames: Frames = None,
    topics: Topics = None,
    offset: Offset = None,
    stamps: Stamps = "header",
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
    report: Annotated[bool, typer.Option("--report", help="Write report.html into the run folder too.")] = False,
    json: Json = False,
) -> None:
    """Replay a log into a pipeline, score it, and write a run folder."""
    from fbench.replay.cli.job import Job, run_job
    from fbench.replay.cli.run_summary import show_run
    from fbench.replay.errors import EXIT_LOSSY, EXIT_OK
    from fbench.replay.excerpt import make_excerpt
    from fbench.replay.fault_budget import parse_budget
    from fbench.replay.read_ahead import make_limit
    from fbench.replay.restamp import make_stamp_params
    from fbench.replay.scores import ScoreOptions
    from fbench.replay.sync import make_sync_params

    job = Job(
        log=log,
        pipeline=pipeline,
        settings=settings or [],
        out=out,
        overwrite=overwrite,
        rate=rate,
        sync=make_sync_params(reference, timeout_ms, tolerance_ms, max_gap_s),
        stamps=make_stamp_params(stamps, offset or []),
        excerpt=make_excerpt(from_, to, frames),
        topics=topics or [],
        read_ahead=make_limit(read_ahead),
        budget=parse_budget(on_fault, fault_budget or []),
        scoring=ScoreOptions(range_m, in_view, distance_m, iou),
        report=report,
        debug=bool(context.find_root().params["debug"]),
    )
    run = run_job(job)
    show_run(run, json)
    raise typer.Exit(EXIT_OK if run.manifest.complete else EXIT_LOSSY)
