"""`fbench verify`."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from fbench.cli.options import (
    Config,
    DetectEvery,
    DetectionsFile,
    Frames,
    From,
    Json,
    Log,
    MaxGapS,
    Offset,
    PipelineOrFile,
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
from fbench.cli.show import console, make_table, print_json, replay_progress, say
from fbench.replay.contracts.errors import EXIT_NO, EXIT_OK

if TYPE_CHECKING:
    from fbench.replay.check.verify import Verified


def verify(
    log: Log,
    pipeline: PipelineOrFile = None,
    settings: Settings = None,
    detect_every: DetectEvery = None,
    config: Config = None,
    rig: RigFiles = None,
    truth: TruthFile = None,
    truth_format: TruthFormat = None,
    truth_frame: TruthFrame = "",
    detections: DetectionsFile = None,
    repeat: Annotated[int, Option(min=1, max=100, help="How often the same is replayed, the first time included.")] = 2,
    quick: Annotated[bool, Option("--quick", help="Try only repeats, another hash seed and more threads.")] = False,
    keep: Annotated[Path | None, Option(help="Keep the runs of all replays in this folder.")] = None,
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
    json: Json = False,
) -> None:
    """Replay in fresh processes under other rates, containers, hash seeds and threads, and say what differs first."""
    from fbench.api.runs import short_name
    from fbench.api.runs import verify as verify_request
    from fbench.cli.options import box_source
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
    )
    with replay_progress(f"{log.name} → {short_name(request.pipeline)}") as progress:
        found = verify_request(request, repeat, quick, keep, progress)
    if json:
        rows = [{**asdict(verdict), "identical": verdict.identical} for verdict in found.verdicts]
        content = {"log": str(log), "pipeline": request.pipeline, "identical": found.identical}
        print_json({**content, "stages": dict(found.digests), "variants": rows})
    else:
        _print(found)
    raise typer.Exit(EXIT_OK if found.identical else EXIT_NO)


def _print(found: "Verified") -> None:
    table = make_table("stage", "digest")
    for stage, text in found.digests.items():
        table.add_row(stage, text)
    console().print(table)
    say("")
    for verdict in found.verdicts:
        differs = f"{verdict.difference} under {verdict.variant}"
        say(f"{verdict.variant}: identical" if verdict.identical else differs)
    num = sum(not verdict.identical for verdict in found.verdicts)
    say("", f"DIVERGED: {num} of {len(found.verdicts)}" if num else f"identical: all {len(found.verdicts)}")
