"""`fbench verify` at work, and what it prints."""

from dataclasses import asdict
from pathlib import Path

from rich.table import Table

from fbench.api.runs import short_name, verify
from fbench.cli.show import console, print_json, replay_progress
from fbench.replay.check.verify import Verified
from fbench.replay.contracts.errors import EXIT_NO, EXIT_OK
from fbench.replay.setup.request import ReplayRequest


def run_verify(request: ReplayRequest, num_repeats: int, quick: bool, keep: Path | None, as_json: bool) -> int:
    """Verify and print what was found; returns the exit code."""
    title = f"{request.log.path.name} → {short_name(request.pipeline)}"
    with replay_progress(title) as progress:
        found = verify(request, num_repeats, quick, keep, progress)
    if as_json:
        print_json(_content(request, found))
    else:
        _print(found)
    return EXIT_OK if found.identical else EXIT_NO


def _content(request: ReplayRequest, found: Verified) -> dict[str, object]:
    rows = [{**asdict(verdict), "identical": verdict.identical} for verdict in found.verdicts]
    return {
        "log": str(request.log.path),
        "pipeline": request.pipeline,
        "identical": found.identical,
        "stages": dict(found.digests),
        "variants": rows,
    }


def _print(found: Verified) -> None:
    out = console()
    table = Table(box=None, pad_edge=False)
    table.add_column("stage")
    table.add_column("digest")
    for stage, text in found.digests.items():
        table.add_row(stage, text)
    out.print(table)
    out.print()
    for verdict in found.verdicts:
        differs = f"{verdict.difference} under {verdict.variant}"
        out.print(f"{verdict.variant}: identical" if verdict.identical else differs, markup=False, soft_wrap=True)
    num = sum(not verdict.identical for verdict in found.verdicts)
    out.print()
    out.print(f"DIVERGED: {num} of {len(found.verdicts)}" if num else f"identical: all {len(found.verdicts)}")
