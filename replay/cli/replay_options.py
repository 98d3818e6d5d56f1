"""Options of `fbench replay`."""

from pathlib import Path
from typing import Annotated

import typer

RunFolder = Annotated[Path | None, typer.Option("--out", "-o", help="Run folder; else runs/LOG-PIPELINE.")]
Rate = Annotated[
    str, typer.Option("--rate", metavar="RATE", help="Pace: 'max', or a multiple of real time such as 0.5 or 10.")
]
OnFault = Annotated[
    str,
    typer.Option("--on-fault", metavar="HOW", help="'strict': lost data mean exit 4; 'tolerant': only counted."),
]
FaultBudgets = Annotated[
    list[str] | None,
    typer.Option(
        "--fault-budget",
        metavar="[CODE=]N",
        help="So many faults that lose data are allowed, of one code or in all; repeatable.",
    ),
]
Report = Annotated[bool, typer.Option("--report", help="Write report.html into the run folder too.")]
