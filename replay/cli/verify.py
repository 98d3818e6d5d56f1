"""`fbench verify`."""

from pathlib import Path
from typing import Annotated

import typer

from fbench.replay.cli.options import Frames, From, Json, Log, Offset, Stamps, To, Topics


def verify(
    log: Log,
    pipeline: Annotated[str, typer.Option("--pipeline", "-p", help="A name (see fbench plugins) or FILE.py:CLASS.")],
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Change a parameter; may be repeated.")
    ] = None,
    repeat: Annotated[int, typer.Option(min=1, max=100, help="Replay the same so often.")] = 2,
    quick: Annotated[bool, typer.Option("--quick", help="Repeat, another hash seed, more threads; no more.")] = False,
    keep: Annotated[Path | None, typer.Option(help="Keep the runs of all replays in this folder.")] = None,
    reference: Annotated[str | None, typer.Option(help="Sensor whose stamps are the frames' instants.")] = None,
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
    from fbench.replay.sync import SyncParams
    from fbench.replay.verify.task import Task

    task = Task(
        log=log,
        pipeline=pipeline,
        folder=Path(),
        settings=settings or [],
        sync=SyncParams(reference),
        stamps=make_stamp_params(stamps, offset or []),
        excerpt=make_excerpt(from_, to, frames),
        topics=topics or [],
    )
    raise typer.Exit(run_verify(task, repeat, quick, keep, json))
