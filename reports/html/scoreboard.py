"""Scores and tables of an experiment as the page shows them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fbench.replay.data.scores import Figure, Kind, Results, ResultTable, Score, format_number
from fbench.replay.runs.folder import Run
from fbench.reports.html.records import DASH, number

PRIMARY = {
    "f1": "F1",
    "precision": "Precision",
    "recall": "Recall",
    "mota": "MOTA",
    "mota_no_fp": "MOTA without FP",
    "motp": "MOTP",
    "idsw": "ID switches",
    "idf1": "IDF1",
    "hota": "HOTA",
}
"""Rows that are shown large, in this order."""
_CARD_COUNTS = ("tp", "fp", "fn", "gt", "idsw")
_WHOLE = ("idsw", "frag", "mt", "pt", "ml")
_OF_SLICES = ("recall", "precision", "f1")

Key = tuple[str, str, str, str]


@dataclass(frozen=True)
class Cell:
    """One score as text."""

    text: str
    unit: str = ""
    reason: str = ""  # Why there is no value
    share: float | None = None  # The value, where it is a ratio that a bar can show
    counts: str = ""  # All raw counts
    short_counts: str = ""  # Those that make up the value


@dataclass(frozen=True)
class Line:
    """One metric with a cell for every run."""

    metric: str
    title: str
    class_: str
    slice: str
    matching: str
    cells: Sequence[Cell]


@dataclass(frozen=True)
class Board:
    """The primary metrics of one class and matching, over all frames."""

    class_: str
    matching: str
    lines: Sequence[Line]

    @property
    def reason(self) -> str:
        """Why the whole board is empty; nothing where it isn't."""
        reasons = [cell.reason for line in self.lines for cell in line.cells]
        return reasons[0] if len(dict.fromkeys(reasons)) == 1 else ""


@dataclass(frozen=True)
class Part:
    """Recall, precision and F1 in one slice, of every run."""

    slice: str
    cells: Sequence[Cell]  # Three for each run, one run after the other


@dataclass(frozen=True)
class Scoreboard:
    """All scores of all runs."""

    boards: Sequence[Board]  # Primary metrics of the first class, one board a matching
    parts: Sequence[Part]  # Slices of the first board: by distance, visibility, sensor and region
    lines: Sequence[Line]  # Every score
    unscored: Sequence[str]  # Labels of runs without scores


def scoreboard(runs: Sequence[Run], labels: Sequence[str]) -> Scoreboard:
    """Join the scores of all runs by metric, class, slice and matching."""
    scored = [(run.folder / "scores.json").is_file() for run in runs]
    columns = [{score.key: score for score in run.scores} if has else {} for run, has in zip(runs, scored, strict=True)]
    keys = dict.fromkeys(key for column in columns for key in column)
    lines = [_line(key, [column.get(key) for column in columns], scored) for key in keys]
    unscored = [label for label, has in zip(labels, scored, strict=True) if not has]
    return Scoreboard(_boards(lines), _parts(lines), lines, unscored)


def _line(key: Key, scores: Sequence[Score | None], scored: Sequence[bool]) -> Line:
    cells = [_cell(score) if score else _absent(has) for score, has in zip(scores, scored, strict=True)]
    return Line(key[0], PRIMARY.get(key[0], key[0]), *key[1:], cells)


def _absent(scored: bool) -> Cell:
    return Cell(DASH, reason="this run has no such score" if scored else "not scored")


def _cell(score: Score) -> Cell:
    whole = isinstance(score.value, int) or score.metric in _WHOLE
    ratio = score.unit == "1" and not whole
    share = min(max(float(score.value), 0.0), 1.0) if ratio and score.value is not None else None
    counts = {name: number(n, 0 if float(n).is_integer() else 3) for name, n in score.counts.items()}
    short = {name: counts[name] for name in _CARD_COUNTS if name in counts and score.value is not None}
    unit = "" if score.unit == "1" else score.unit
    return Cell(
        number(score.value, 0 if whole else 3),
        unit,
        score.reason or "",
        share,
        _join_boards(counts),
        _join_boards(short),
    )


def _join_boards(counts: Mapping[str, str]) -> str:
    return " · ".join(f"{name} {count}" for name, count in counts.items())


def _boards(lines: Sequence[Line]) -> list[Board]:
    """Group the primary metrics of the first class by matching."""
    groups: dict[tuple[str, str], list[Line]] = {}
    for line in lines:
        if line.metric in PRIMARY and line.slice == "all":
            groups.setdefault((line.class_, line.matching), []).append(line)
    first = [class_ for class_, _ in groups][:1]
    order = list(PRIMARY)
    return [
        Board(class_, matching, sorted(group, key=lambda line: order.index(line.metric)))
        for (class_, matching), group in groups.items()
        if class_ in first
    ]


def _parts(lines: Sequence[Line]) -> list[Part]:
    """Group recall, precision and F1 of the first class by slice, without slices in which there is nothing."""
    of = next(((line.class_, line.matching) for line in lines if line.metric in PRIMARY), None)
    groups: dict[str, dict[str, Line]] = {}
    for line in lines:
        if line.metric in _OF_SLICES and line.slice != "all" and (line.class_, line.matching) == of:
            groups.setdefault(line.slice, {})[line.metric] = line
    parts = [Part(name, _side_by_side(group)) for name, group in groups.items()]
    return [part for part in parts if any(cell.text != DASH for cell in part.cells)]


def _side_by_side(group: Mapping[str, Line]) -> list[Cell]:
    num_runs = len(next(iter(group.values())).cells)
    found = [group.get(metric) for metric in _OF_SLICES]
    return [Cell(DASH) if line is None else line.cells[run] for run in range(num_runs) for line in found]


@dataclass(frozen=True)
class ResultCell:
    """One figure as text."""

    text: str
    published: str  # What the source system's authors give; empty where they give nothing
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
        ResultLine(line.name, line.space, [_results_cell(f, kind) for f, kind in zip(line.figures, kinds, strict=True)])
        for line in table.lines
    ]
    columns = [
        ResultColumn(column.name, any(line.cells[i].published for line in lines))
        for i, column in enumerate(table.columns)
    ]
    return ResultBoard(
        table.title, columns, lines, table.notes, table.has_spaces, any(column.has_published for column in columns)
    )


def _results_cell(figure: Figure, kind: Kind) -> ResultCell:
    published = "" if figure.published is None else _minus(format_number(figure.published, kind))
    counts = " · ".join(f"{name.replace('_', ' ')} {num:g}" for name, num in figure.counts.items())
    return ResultCell(_minus(format_number(figure.value, kind)), published, figure.reason or "", counts)


def _minus(text: str) -> str:
    """With a true minus sign."""
    return text if text == DASH else text.replace("-", "\u2212")
