"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

Log = Annotated[Path, typer.Argument(metavar="LOG", help="An MCAP file, Parquet folder, ROS bag, or folder of parts.")]
Pipeline = Annotated[
    str,
    typer.Option("--pipeline", "-p", metavar="NAME", help="A name (see fbench plugins), FILE.py:CLASS or FILE.toml."),
]
Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Change a parameter; repeatable.")
]
RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="A run folder.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an existing run.")]
RangeM = Annotated[
    float, typer.Option("--range-m", metavar="M", min=0, help="Score objects within this distance, in m.")
]
InView = Annotated[bool, typer.Option("--in-view/--all-around", help="Score only objects that a camera sees.")]
DistanceM = Annotated[
    float, typer.Option("--distance-m", metavar="M", min=0, help="3D match: centres this near on the ground, in m.")
]
Reference = Annotated[
    str | None, typer.Option("--reference", metavar="SENSOR", help="Whose stamps are the frames' instants.")
]
TimeoutMs = Annotated[
    float | None,
    typer.Option(
        "--timeout-ms",
        metavar="MS",
        min=0,
        help="How long a frame waits for its sensors, in ms; else 30, or as the log says.",
    ),
]
ToleranceMs = Annotated[
    float | None,
    typer.Option(
        "--tolerance-ms", metavar="MS", min=0, help="How far stamps may lie from the instant, in ms; else 50."
    ),
]
MaxGapS = Annotated[
    float | None,
    typer.Option("--max-gap-s", metavar="S", min=0, help="A longer pause begins a new segment, in s; else 2."),
]
From = Annotated[
    str | None,
    typer.Option("--from", metavar="T", help="First instant: seconds after the first measurement, or a stamp 'Nns'."),
]
To = Annotated[str | None, typer.Option("--to", metavar="T", help="Instant at which to stop, itself left out.")]
Frames = Annotated[str | None, typer.Option("--frames", metavar="A:B", help="Indices of frames, B left out.")]
Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topics", metavar="PATTERN", help="Read only these topics or sensors (not: '!PATTERN'); repeatable."
    ),
]
Sensors = Annotated[
    list[str] | None,
    typer.Option(
        "--sensors", metavar="PATTERN", help="Give the pipeline only these sensors (not: '!PATTERN'); repeatable."
    ),
]
Offset = Annotated[
    list[str] | None,
    typer.Option("--offset", metavar="SENSOR=MS", help="Add this to the stamps of a sensor; repeatable."),
]
Stamps = Annotated[
    str | None,
    typer.Option(
        "--stamps",
        metavar="SOURCE",
        help="Instants are those of the 'header' (by default), or of the 'log', when it was recorded.",
    ),
]
ReadAhead = Annotated[
    str, typer.Option("--read-ahead", metavar="N", help="Messages to decode in advance: a number, 'all' or 'auto'.")
]
InterpolateTruth = Annotated[
    float,
    typer.Option(
        "--interpolate-truth",
        metavar="MS",
        min=0,
        help="Frames without truth of their own get some by interpolation between truths that are at most this far "
        "apart, in ms; 0: they don't.",
    ),
]
MinCoverage = Annotated[
    float,
    typer.Option(
        "--min-coverage", metavar="SHARE", min=0, max=1, help="Exit 1 where a smaller share of outputs had truth."
    ),
]
NoMedia = Annotated[bool, typer.Option("--no-media", help="Keep no images and no points in the run.")]
Redact = Annotated[
    bool,
    typer.Option("--redact", help="Also leave out names of the log and of files, paths, places of faults and poses."),
]
Iou = Annotated[float, typer.Option("--iou", metavar="SHARE", min=0, max=1, help="2D match: at least this overlap.")]
