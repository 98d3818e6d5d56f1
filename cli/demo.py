"""`fbench demo`."""

from pathlib import Path
from typing import Annotated, Literal

import typer


def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for logs, runs, tables and the report.")] = Path(
        "runs/demo"
    ),
    split: Annotated[
        Literal["dev", "test"] | None,
        typer.Option(help="The full suite instead of its short version, with seeds to develop on, or to report."),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(metavar="S", help="Length of each log, in s: 1.5, with --split 10.")
    ] = None,
    num_seeds: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Only the first N seeds of the split.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(metavar="N", min=1, max=256, help="Replays at a time; changes no result.")
    ] = None,
) -> None:
    """Simulate drives through a city in all weathers, replay them into all pipelines, and compare.

    What is there from an earlier time isn't made again.
    """
    from fbench.cli.demo_job import DemoWish, run_demo

    raise typer.Exit(run_demo(DemoWish(out, split, seconds, num_seeds, workers)))
