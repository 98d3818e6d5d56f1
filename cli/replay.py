"""`fbench replay`."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from fbench.cli.options import (
    Config,
    DetectEvery,
    DetectionsFile,
    DistanceM,
    Frames,
    From,
    InterpolateTruthMs,
    InView,
    Iou,
    Json,
    Log,
    MaxGapS,
    MinCoverage,
    NoMedia,
    Offset,
    Overwrite,
    PipelineOrFile,
    RangeM,
    ReadAhead,
    Redact,
    Reference,
    RigFiles,
    Sensors,
    Settings,
    Stamps,
    TimeoutMs,
    To,
    ToleranceMs,
    Topics,
    TruthFile,
    TruthFormat,
    TruthFrame,
)

RunFolder = Annotated[Path | None, Option("--out", "-o", help="Run folder; else runs/LOG-PIPELINE.")]
Rate = Annotated[
    str, Option("--rate", metavar="RATE", help="Pace: 'max', or a multiple of real time such as 0.5 or 10.")
]
OnFault = Annotated[
    str, Option("--on-fault", metavar="HOW", help="'strict': lost data mean exit 4; 'tolerant': only counted.")
]
FaultBudgets = Annotated[
    list[str] | None,
    Option(
        "--fault-budget",
        metavar="[CODE=]N",
        help="So many faults that lose data are allowed, of one code or in all; repeatable.",
    ),
]
Report = Annotated[bool, Option("--report", help="Write report.html into the run folder too.")]


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
    interpolate_truth_ms: InterpolateTruthMs = 0.0,
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
    import sys
    from contextlib import redirect_stdout

    from fbench.api.runs import name_pipeline
    from fbench.api.runs import replay as replay_request
    from fbench.cli.options import box_source
    from fbench.cli.run_summary import require_coverage, show_run
    from fbench.cli.show import frame_progress
    from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK
    from fbench.replay.data.scores import ScoreOptions
    from fbench.replay.setup.request import ReplayRequest, choose_pipeline
    from fbench.replay.setup.source import LogRequest

    results = box_source(detections, None, truth_frame)
    request = ReplayRequest(
        LogRequest(log, config, rig or (), box_source(truth, truth_format, truth_frame), results, topics or ()),
        choose_pipeline(pipeline, results),
        settings or (),
        detect_every,
        sensors or (),
        reference,
        timeout_ms,
        tolerance_ms,
        max_gap_s,
        offset or (),
        stamps,
        from_,
        to,
        frames,
        interpolate_truth_ms,
        out,
        overwrite,
        rate,
        read_ahead,
        on_fault,
        fault_budget or (),
        ScoreOptions(range_m, in_view, distance_m, iou),
        no_media,
        redact,
        report,
    )
    # What a plug-in prints must not get between the lines of --json.
    title = f"{log.name} → {name_pipeline(request)}"
    with redirect_stdout(sys.stderr), frame_progress(title) as progress:
        run = replay_request(request, progress, _first_traceback(bool(context.find_root().params["debug"]))).run
    show_run(run, json)
    raise typer.Exit(require_coverage(run, min_coverage, EXIT_OK if run.manifest.complete else EXIT_LOSSY))


def _first_traceback(debug: bool) -> Callable[[BaseException], None]:
    """Return what shows the first exception that it gets, if that is wanted."""
    left = [True] if debug else []

    def show(error: BaseException) -> None:
        import sys
        import traceback

        from fbench.replay.runs.secrets import without_secrets

        if left:
            left.pop()
            sys.stderr.write(without_secrets("".join(traceback.format_exception(error))))

    return show
