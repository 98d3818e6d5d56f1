"""`fbench compare`."""

from pathlib import Path
from typing import Annotated

import typer

from fbench.cli.options import Json


def compare(
    base: Annotated[Path, typer.Argument(metavar="BASE", help="The run to compare with.")],
    head: Annotated[Path, typer.Argument(metavar="HEAD", help="The run that should not be worse.")],
    tolerance: Annotated[float, typer.Option(min=0, help="How much a primary metric may fall.")] = 0.0,
    json: Json = False,
) -> None:
    """Print what changed between two runs; exit 1 when a primary metric fell by more than the tolerance."""
    from fbench.cli.comparison import compare_runs

    raise typer.Exit(compare_runs(base, head, tolerance, json))
