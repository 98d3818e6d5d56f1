"""`fbench replay`."""

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
from fbench.replay.cli.replay_options import FaultBudgets, OnFault, Rate, Report, RunFolder


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
    from fbench.replay.cli.coverage_gate import gated
    from fbench.replay.cli.job import run_job
    from fbench.replay.cli.log_options import box_source, pipeline_of
    from fbench.replay.cli.replay_wish import FrameWish, PipelineWish, RunWish, make_job
    from fbench.replay.cli.run_summary import show_run
    from fbench.replay.config.source import LogWish
    from fbench.replay.errors import EXIT_LOSSY, EXIT_OK
    from fbench.replay.scores import ScoreOptions

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
