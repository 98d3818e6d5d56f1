"""`fbench verify` at work, and what it prints."""

from dataclasses import asdict
from pathlib import Path

from rich.table import Table

from fbench.cli.progress import replay_progress
from fbench.cli.replay_job import short_name
from fbench.cli.show import console, print_json
from fbench.replay.check.verify import Verified, verify, workplace
from fbench.replay.check.verify_task import Task
from fbench.replay.contracts.errors import EXIT_NO, EXIT_OK


def run_verify(task: Task, num_repeats: int, quick: bool, keep: Path | None, as_json: bool) -> int:
    """Verify and print what was found; returns the exit code."""
    title = f"{task.log.log.name} → {short_name(task.pipeline)}"
    with workplace(keep) as folder, replay_progress(title) as progress:
        found = verify(task, num_repeats, quick, folder, progress)
    if as_json:
        print_json(_content(task, found))
    else:
        _print(found)
    return EXIT_OK if found.identical else EXIT_NO


def _content(task: Task, found: Verified) -> dict[str, object]:
    rows = [{**asdict(verdict), "identical": verdict.identical} for verdict in found.verdicts]
    return {
        "log": str(task.log.log),
        "pipeline": task.pipeline,
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
