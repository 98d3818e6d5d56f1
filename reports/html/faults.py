"""The fault table of all runs: every code is shown, also when nothing happened."""

from collections.abc import Sequence
from dataclasses import dataclass

from fbench.replay.faults import FAULTS
from fbench.replay.store import Run
from fbench.reports.html.records import FaultRow, FaultTable, read_record
from fbench.reports.html.text import DASH


@dataclass(frozen=True)
class FaultLine:
    """One code with its counts, one a run."""

    code: str
    text: str
    loses_data: bool
    counts: Sequence[str]
    places: Sequence[tuple[str, Sequence[str]]]
    """First places by label of the run."""
    total: int


def fault_lines(runs: Sequence[Run], labels: Sequence[str]) -> list[FaultLine]:
    """Return all codes of the fault table, and those of the runs that this version doesn't know."""
    tables = [read_record(run, "faults.json", FaultTable) for run in runs]
    columns = [{row.code: row for row in table.rows} if table else {} for table in tables]
    known = {
        code: FaultRow(code=code, behaviour=kind.behaviour, text=kind.text, count=0) for code, kind in FAULTS.items()
    }
    rows = known | {code: row for column in columns for code, row in column.items() if code not in known}
    return [_line(row, [column.get(row.code) for column in columns], labels) for row in rows.values()]


def _line(row: FaultRow, cells: Sequence[FaultRow | None], labels: Sequence[str]) -> FaultLine:
    places = [(label, cell.places) for label, cell in zip(labels, cells, strict=True) if cell and cell.places]
    counts = [DASH if cell is None else str(cell.count) for cell in cells]
    return FaultLine(
        row.code, row.text, row.behaviour == "count", counts, places, sum(cell.count for cell in cells if cell)
    )
