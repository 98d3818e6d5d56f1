"""`fbench replay`."""

from pathlib import Path
from typing import Annotated

import typer

from fbench.cli.options import (
    Config,
    DetectEvery,
    DetectionsFile,
    DistanceM,  # fmt: skip
    Frames,  # fmt: skip
    From,  # fmt: skip
    InterpolateTruth,  # fmt: skip
    InView,  # fmt: skip
    Iou,  # fmt: skip
    Json,  # fmt: skip
    Log,  # fmt: skip
    MaxGapS,  # fmt: skip
    MinCoverage,  # fmt: skip
    NoMedia,  # fmt: skip
    Offset,  # fmt: skip
    Overwrite,  # fmt: skip
    PipelineOrFile,
    RangeM,  # fmt: skip
    ReadAhead,  # fmt: skip
    Redact,  # fmt: skip
    Reference,  # fmt: skip
    RigFiles,
    Sensors,  # fmt: skip
    Settings,  # fmt: skip
    Stamps,  # fmt: skip
    TimeoutMs,  # fmt: skip
    To,  # fmt: skip
    ToleranceMs,  # fmt: skip
    Topics,  # fmt: skip
    TruthFile,
    TruthFormat,
    TruthFrame,
    with_detect_every,
)

RunFolder = Annotated[Path | None, typer.Option("--out", "-o", help="Run folder; else runs/LOG-PIPELINE.")]
Rate = Annotated[
    str, typer.Option("--rate", metavar="RATE", help="Pace: 'max', or a multiple of real time such as 0.5 or 10.")
]
OnFault = Annotated[
    str,
    typer.Option("--on-fault", metavar="HOW", help="'strict': lost data mean exit 4; 'tolerant': only counted."),
]
FaultBudgets = Annotated[
    list[str] | None,
    typer.Option(
        "--fault-budget",
        metavar="[CODE=]N",
        help="So many faults that lose data are allowed, of one code or in all; repeatable.",
    ),
]
Report = Annotated[bool, typer.Option("--report", help="Write report.html into the run folder too.")]


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
    out: RunFolder = None,
    overwrite: Overwrite = False,
    rate: Rate = "max",
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
    on_fault: OnFault = "strict",
    fault_budget: FaultBudgets = None,
    range_m: RangeM = 50.0,
    in_view: InView = True,
    distance_m: DistanceM = 2.0,
    iou: Iou = 0.5,
    min_coverage: MinCoverage = 0.0,
    no_media: NoMedia = False,
    redact: Redact = False,
    report: Report = False,
    json: Json = False,
) -> None:
    """Replay a log into a pipeline, score it, and write a run folder."""
    from fbench.cli.options import box_source, pipeline_of
    from fbench.cli.replay_job import FrameWish, PipelineWish, RunWish, make_job, run_job
    from fbench.cli.run_summary import show_run
    from fbench.cli.score_jobs import gated
    from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK
    from fbench.replay.data.scores import ScoreOptions
    from fbench.replay.setup.source import LogWish

    filed = box_source(truth, truth_format, truth_frame)
    results = box_source(detections, None, truth_frame)
    name = pipeline_of(pipeline, results)
    job = make_job(
        LogWish(log, config, rig or [], filed, results, topics or []),
        PipelineWish(name, with_detect_every(name, settings or [], detect_every), sensors or []),
        FrameWish(
            reference, timeout_ms, tolerance_ms, max_gap_s, from_, to, frames, offset or [], stamps, interpolate_truth
        ),
        RunWish(
            out, overwrite, rate, read_ahead, on_fault, fault_budget or [],
            no_media=no_media, redact=redact, report=report, debug=bool(context.find_root().params["debug"]),
        ),
        ScoreOptions(range_m, in_view, distance_m, iou),
    )  # fmt: skip
    run = run_job(job)
    show_run(run, json)
    raise typer.Exit(gated(run, min_coverage, EXIT_OK if run.manifest.complete else EXIT_LOSSY))
