"""What `fbench log convert` does and prints."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.table import Table

from fbench.replay.cli.fault_text import explained, fault_lines
from fbench.replay.cli.progress import message_progress
from fbench.replay.cli.show import console, print_json
from fbench.replay.errors import EXIT_LOSSY, EXIT_OK
from fbench.replay.faults import FaultLog
from fbench.replay.logs.convert.run import Wish, convert
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.convert.write import Converted
from fbench.replay.logs.open import open_container

_NO_USE = "LOG012"
"""Topics that fbench has no use for are converted like all others."""


def run_convert(source: Path, target: Target, wish: Wish, as_json: bool) -> int:
    """Convert a log and print what was written; returns the exit code."""
    faults = FaultLog()
    with explained(faults):
        container = open_container(source, faults)
        total = sum(container.counts.values())
        with message_progress(f"{source.name} → {target.path.name}", total) as progress:
            result = convert(container, target, wish, progress)
    rows = [row for row in faults.rows() if row["code"] != _NO_USE]
    if as_json:
        print_json({**_content(result), "faults": rows})
    else:
        _print(result, rows)
    return EXIT_LOSSY if faults.lost else EXIT_OK


def _content(result: Converted) -> dict[str, object]:
    return {**asdict(result), "path": str(result.path)}


def _print(result: Converted, rows: list[dict[str, Any]]) -> None:
    out = console()
    table = Table(box=None, pad_edge=False)
    table.add_column("topic", overflow="fold")
    table.add_column("messages", justify="right")
    for topic, num in result.messages.items():
        table.add_row(topic, str(num))
    out.print(table)
    for line in _lines(result, rows):
        out.print(line, markup=False, soft_wrap=True)


def _lines(result: Converted, rows: list[dict[str, Any]]) -> Iterator[str]:
    for topic, num in result.left_out.items():
        yield f"left out: {num} messages on {topic}, which fbench doesn't understand"
    yield from fault_lines(rows)
    rigs = f", {result.num_rigs} {'rig' if result.num_rigs == 1 else 'rigs'}" if result.num_rigs else ""
    parts = f" in {len(result.parts)} parts" if result.parts else ""
    total = sum(result.messages.values())
    yield f"id: {result.log_id}"
    yield f"log: {result.path}: {total} messages{rigs}, {result.num_bytes / 1e6:.3g} MB{parts}"
