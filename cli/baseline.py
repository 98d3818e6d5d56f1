"""`fbench baseline`."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from fbench.cli.options import examples
from fbench.cli.show import say

app = typer.Typer(help="Keep accepted results in git, for `fbench compare`.", no_args_is_help=True)

Source = Annotated[Path, Argument(metavar="RUN", help="Run or suite whose results are good.")]
Reason = Annotated[str, Option(metavar="TEXT", help="Why they are good; reviewers read it.")]
Out = Annotated[Path, Option("-o", "--out", metavar="FILE", help="The baseline file, replaced if it exists.")]
By = Annotated[str | None, Option(metavar="NAME", help="Who accepts them; default: the user that git knows.")]
At = Annotated[str | None, Option(metavar="DATE", help="When; default: the date of the last commit.")]


@app.command("accept", epilog=examples("baseline accept"))
def accept(source: Source, reason: Reason, out: Out = Path("baseline.json"), by: By = None, at: At = None) -> None:
    """Write counts and digests of a run or suite to a small file for git: with who accepted them, when, and why."""
    from fbench.api.baselines import accept as accept_results

    done = accept_results(source, reason, out, by, at)
    if (before := done.replaced) is not None:
        say(f"replaces what {before.by} accepted on {before.at}: {before.reason}")
    own = done.acceptance
    cells = "a run" if done.num_cells == 1 else f"{done.num_cells} cells"
    size = f"{done.path.stat().st_size / 1024:.0f} KiB"
    say(f"{done.path}: {cells}, {size}, accepted by {own.by} on {own.at}: {own.reason}")
