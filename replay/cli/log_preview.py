"""`fbench log preview`."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from fbench.replay.cli.log_options import Config, RigFiles, TruthFile, TruthFormat, TruthFrame
from fbench.replay.cli.options import Frames, Json, Log, Offset, Reference, Stamps, Topics


def preview(
    log: Log,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder of the pictures; else LOG-preview.")] = None,
    frames: Frames = None,
    num: Annotated[int, typer.Option(metavar="N", min=1, max=200, help="So many frames, evenly spread.")] = 6,
    config: Config = None,
    rig: RigFiles = None,
    truth: TruthFile = None,
    truth_format: TruthFormat = None,
    truth_frame: TruthFrame = "",
    reference: Reference = None,
    offset: Offset = None,
    stamps: Stamps = None,
    topics: Topics = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing preview.")] = False,
    json: Json = False,
) -> None:
    """Draw what sensors see into each other: whether calibration, time and Doppler are right shows at one look."""
    from fbench.replay.cli.log_options import box_source
    from fbench.replay.cli.preview_job import TIMEOUT_NS, PreviewJob, run_preview
    from fbench.replay.config.source import LogWish, log_source
    from fbench.replay.excerpt import make_excerpt

    filed = box_source(truth, truth_format, truth_frame)
    source = log_source(LogWish(log, config, rig or [], filed, None, topics or []))
    job = PreviewJob(
        log=source,
        out=out,
        overwrite=overwrite,
        num=num,
        sync=replace(source.sync(reference, None, None, None), timeout_ns=TIMEOUT_NS),
        stamps=source.stamps(stamps, offset or []),
        excerpt=make_excerpt(None, None, frames),
        as_json=json,
    )
    run_preview(job)
