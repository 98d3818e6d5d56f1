"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

Log = Annotated[Path, typer.Argument(metavar="LOG", help="An MCAP file.")]
RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="A run folder.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an existing run.")]
RangeM = Annotated[float, typer.Option("--range-m", min=0, help="Score objects within this distance [m].")]
InView = Annotated[bool, typer.Option("--in-view/--all-around", help="Score only objects that a camera sees.")]
DistanceM = Annotated[float, typer.Option("--distance-m", min=0, help="3D match: centres this near on the ground [m].")]
Iou = Annotated[float, typer.Option("--iou", min=0, max=1, help="2D match: at least this overlap.")]
