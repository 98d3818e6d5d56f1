"""`fbench demo`."""

from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the log, the runs and the report.")] = Path(
        "runs/demo"
    ),
) -> None:
    """Simulate a short drive through a city, replay it into three pipelines, and write one report."""
    from fbench.replay.cli.demo_job import run_demo

    run_demo(out)
