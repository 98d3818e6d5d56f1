"""Tables of an experiment as the page shows them."""

from collections.abc import Sequence
from dataclasses import dataclass

from fbench.replay.result_table import Figure, Kind, Results, ResultTable, shown
from fbench.reports.html.text import DASH


@dataclass(frozen=True)
class ResultCell:
    """One figure as text."""

    text: str
    published: str
    """What the source system's authors give; empty where they give nothing."""
    reason: str
    counts: str


@dataclass(frozen=True)
class ResultLine:
    """One configuration in one space."""

    name: str
    space: str
    cells: Sequence[ResultCell]


@dataclass(frozen=True)
class ResultColumn:
    """The head of a column."""

    name: str
    has_published: bool


@dataclass(frozen=True)
class ResultBoard:
    """One table."""

    title: str
    columns: Sequence[ResultColumn]
    lines: Sequence[ResultLine]
    notes: Sequence[str]
    has_spaces: bool
    has_published: bool


@dataclass(frozen=True)
class ResultView:
    """All tables, what ran, and what went wrong."""

    facts: Sequence[tuple[str, str]]
    boards: Sequence[ResultBoard]
    problems: Sequence[str]


def result_view(results: Results) -> ResultView:
    """Turn numbers into text."""
    return ResultView(results.facts, [_board(table) for table in results.tables], results.problems)


def _board(table: ResultTable) -> ResultBoard:
    kinds = [column.kind for column in table.columns]
    lines = [
        ResultLine(line.name, line.space, [_cell(f, kind) for f, kind in zip(line.figures, kinds, strict=True)])
        for line in table.lines
    ]
    columns = [
        ResultColumn(column.name, any(line.cells[i].published for line in lines))
        for i, column in enumerate(table.columns)
    ]
    return ResultBoard(
        table.title, columns, lines, table.notes, table.has_spaces, any(column.has_published for column in columns)
    )


def _cell(figure: Figure, kind: Kind) -> ResultCell:
    published = "" if figure.published is None else _minus(shown(figure.published, kind))
    counts = " · ".join(f"{name.replace('_', ' ')} {num:g}" for name, num in figure.counts.items())
    return ResultCell(_minus(shown(figure.value, kind)), published, figure.reason or "", counts)


def _minus(text: str) -> str:
    """With a true minus sign."""
    return text if text == DASH else text.replace("-", "\u2212")
