"""Options of `fbench score`."""

from pathlib import Path
from typing import Annotated

import typer

Runs = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="[RUN]...",
        help="A run folder, or several of one pipeline; without one, --truth and --detections are scored.",
        show_default=False,
    ),
]
DetectionsFormat = Annotated[
    str | None,
    typer.Option("--detections-format", metavar="FORMAT", help="Of --detections, where its content doesn't tell."),
]
Profile = Annotated[
    str | None,
    typer.Option(
        "--profile",
        metavar="NAME",
        help="Whose way to count, see fbench plugins profiles; else 'default', fbench's own.",
    ),
]
Match = Annotated[
    str | None,
    typer.Option("--match", metavar="HOW:NUMBER", help="What matches in the profile: iou3d:0.25, iou2d:0.5, bev:2 ..."),
]
Class = Annotated[list[str] | None, typer.Option("--class", metavar="NAME", help="Only this class; repeatable.")]
Sequences = Annotated[
    str | None, typer.Option("--sequences", metavar="NAMES", help="Of files: only these, with commas between.")
]
Seqmap = Annotated[
    Path | None,
    typer.Option(
        "--seqmap", metavar="FILE", help="Of files: a list of sequences with their lengths, as TrackEval reads it."
    ),
]
Missing = Annotated[
    str, typer.Option("--missing", metavar="WHAT", help="Sequences without a file of results: 'error' or 'empty'.")
]
Out = Annotated[
    Path | None,
    typer.Option(
        "-o", "--out", metavar="FILE", help="Write all rows there, as JSON: of a profile, or of several RUNs."
    ),
]
Region = Annotated[
    str | None,
    typer.Option("--region", metavar="KINDS", help="Only boxes in these regions of the log: road, or road,sidewalk."),
]
Seen = Annotated[
    int,
    typer.Option(
        "--seen",
        metavar="N",
        min=0,
        help="Score only objects that some sensor of the log sees, as its truth tells: with N points of a LiDAR or "
        "radar, such as 1, or in an image.",
    ),
]
Explain = Annotated[
    int | None, typer.Option("--explain", metavar="FRAME", help="What became of each box of this frame, and why.")
]
Intervals = Annotated[
    int,
    typer.Option(
        "--intervals",
        metavar="N",
        min=0,
        help="95 % confidence intervals from N bootstrap resamples, 20 to 100000; such as 1000.",
    ),
]
Seed = Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Of the resamples.")]
