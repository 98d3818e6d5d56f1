"""`fbench verify`."""

from pathlib import Path
from typing import Annotated

import typer

from fbench.replay.cli.options import (
    Frames,
    From,
    Json,
    Log,
    MaxGapS,
    Offset,
    Pipeline,
    Reference,
    Settings,
    Stamps,
    TimeoutMs,
    To,
    ToleranceMs,
    Topics,
)


def verify(
    log: Log,
    pipeline: Pipeline,
    settings: Settings = None,
    repeat: Annotated[
        int, typer.Option(min=1, max=100, help="How often the same is replayed, the first time included.")
    ] = 2,
    quick: Annotated[
        bool, typer.Option("--quick", help="Try only repeats, another hash seed and more threads.")
    ] = False,
    keep: Annotated[Path | None, typer.Option(help="Keep the runs of all replays in this folder.")] = None,
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
    json: Json = False,
) -> None:
    """Replay in fresh processes under other rates, containers, hash seeds and threads, and say what differs first."""
    from fbench.replay.cli.verify_job import run_verify
    from fbench.replay.excerpt import make_excerpt
    from fbench.replay.restamp import make_stamp_params
    from fbench.replay.sync import make_sync_params
    from fbench.replay.verify.task import Task

    task = Task(
        log=log,
        pipeline=pipeline,
        folder=Path(),
        settings=settings or [],
        sync=make_sync_params(reference, timeout_ms, tolerance_ms, max_gap_s),
        stamps=make_stamp_params(stamps, offset or []),
        excerpt=make_excerpt(from_, to, frames),
        topics=topics or [],
    )
    raise typer.Exit(run_verify(task, repeat, quick, keep, json))
