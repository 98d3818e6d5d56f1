"""`fbench replay`."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from fbench.cli import options


def replay(
    context: typer.Context,
    log: options.Log,
    pipeline: options.PipelineOrFile = None,
    settings: options.Settings = None,
    detect_every: options.DetectEvery = None,
    latency: options.Latency = None,
    overload: options.Overload = None,
    budget_ms: options.BudgetMs = 100.0,
    config: options.Config = None,
    rig: options.RigFiles = None,
    decoder: options.Decoders = None,
    truth: options.TruthFile = None,
    truth_format: options.TruthFormat = None,
    truth_frame: options.TruthFrame = "",
    interpolate_truth_ms: options.InterpolateTruthMs = 0.0,
    detections: options.DetectionsFile = None,
    out: Annotated[Path | None, Option("--out", "-o", help="Run folder; runs/LOG-PIPELINE by default.")] = None,
    overwrite: options.Overwrite = False,
    rate: Annotated[
        str, Option(metavar="RATE", help="Pace: 'max', or a multiple of real time such as 0.5 or 10.")
    ] = "max",
    overlap: options.Overlap = 1,
    reference: options.Reference = None,
    timeout_ms: options.TimeoutMs = None,
    tolerance_ms: options.ToleranceMs = None,
    max_gap_s: options.MaxGapS = None,
    from_: options.From = None,
    to: options.To = None,
    frames: options.Frames = None,
    topics: options.Topics = None,
    sensors: options.Sensors = None,
    offset: options.Offset = None,
    stamps: options.Stamps = None,
    condition: options.Condition = "",
    seed: options.Seed = 0,
    read_ahead: options.ReadAhead = "auto",
    on_fault: Annotated[
        str, Option(metavar="HOW", help="'strict': exit 4 if data were lost; 'tolerant': only count it.")
    ] = "strict",
    fault_budget: Annotated[
        list[str] | None,
        Option(
            metavar="[CODE=]N", help="Allowed number of faults that lose data, in total or of one code; repeatable."
        ),
    ] = None,
    range_m: options.RangeM = 50.0,
    in_view: options.InView = True,
    distance_m: options.DistanceM = 2.0,
    iou: options.Iou = 0.5,
    min_coverage: options.MinCoverage = 0.0,
    no_media: options.NoMedia = False,
    redact: options.Redact = False,
    report: Annotated[bool, Option("--report", help="Also write report.html into the run folder.")] = False,
    device: options.Device = "cpu",
    isolate: options.Isolate = False,
    frame_timeout_s: options.FrameTimeoutS = 10.0,
    json: options.Json = False,
) -> None:
    """Replay a log into a pipeline, score it, and write a run folder."""
    from fbench.api.replays import name_pipeline
    from fbench.api.replays import replay as replay_log
    from fbench.cli.progress import frame_progress
    from fbench.cli.run_summary import require_coverage, show_run
    from fbench.cli.show import plugin_output, show_traceback
    from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK
    from fbench.replay.data.scores import ScoreOptions
    from fbench.replay.setup.request import ReplayRequest, choose_pipeline
    from fbench.replay.setup.source import LogRequest

    boxes = options.box_source(truth, truth_format, truth_frame)
    results = options.box_source(detections, None, truth_frame)
    source = LogRequest(log, config, rig or (), boxes, results, topics or (), decoder or ())
    request = ReplayRequest(
        source,
        choose_pipeline(pipeline, results),
        settings=settings or (),
        detect_every=detect_every,
        latency=latency,
        overload=overload,
        budget_ms=budget_ms,
        sensors=sensors or (),
        reference=reference,
        timeout_ms=timeout_ms,
        tolerance_ms=tolerance_ms,
        max_gap_s=max_gap_s,
        offset=offset or (),
        stamps=stamps,
        from_=from_,
        to=to,
        frames=frames,
        condition=condition,
        seed=seed,
        interpolate_truth_ms=interpolate_truth_ms,
        out=out,
        overwrite=overwrite,
        rate=rate,
        overlap=overlap,
        read_ahead=read_ahead,
        on_fault=on_fault,
        fault_budget=fault_budget or (),
        scoring=ScoreOptions(range_m, in_view, distance_m, iou),
        no_media=no_media,
        redact=redact,
        report=report,
        device=device,
        isolate=isolate,
        frame_timeout_s=frame_timeout_s,
    )
    debug, failed = bool(context.find_root().params["debug"]), list[BaseException]()

    def show_first(error: BaseException) -> None:
        if debug and not failed:
            failed.append(error)
            show_traceback(error)

    title = f"{log.name} → {name_pipeline(request)}"
    with frame_progress(title) as progress, plugin_output():
        run = replay_log(request, progress, show_first).run
    show_run(run, json)
    raise typer.Exit(require_coverage(run, min_coverage, EXIT_OK if run.manifest.complete else EXIT_LOSSY))
