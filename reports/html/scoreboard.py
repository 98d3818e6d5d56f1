"""Scores of runs as the page shows them: cards of one run, one table of several, slices, and a map of conditions."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from fbench.replay.data.scores import FORECAST, LOCKSTEP, STREAMING, Column, Figure, Results, ResultTable, Score
from fbench.replay.data.scores import Line as ResultLine
from fbench.replay.runs.folder import Run
from fbench.reports.html.records import number, shade, visible
from fbench.reports.html.results import result_view

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
SPACES = {"bev": "3D", "iou": "Image"}
"""Beginnings of matchings, and what they compare in."""
CLEAR, VEHICLE = "clear", "vehicle"
_SUMMARY = ("f1", "precision", "recall", "mota", "idf1", "hota", "idsw")
_SHORT = {"precision": "Prec.", "idsw": "IDSW"}
_LOWER = ("idsw", "motp")  # Better when lower
_CARD_COUNTS = ("tp", "fp", "fn", "gt", "idsw")
WHOLE = ("idsw", "frag", "mt", "pt", "ml")
OF_SLICES = ("f1", "recall", "precision", "mota")
_OF_LATENCY = (LOCKSTEP, STREAMING, FORECAST)


@dataclass(frozen=True)
class Cell:
    """One score as text; all empty where a run has no such score."""

    text: str = ""
    unit: str = ""
    reason: str = ""  # Why there is no value
    share: float | None = None  # The value, where it is a ratio that a bar can show
    counts: str = ""  # All raw counts
    short_counts: str = ""  # Those that make up the value
    shade: int | None = None  # The share in tenths
    best: bool = False  # Of its column


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
class Setting:
    """Runs that saw the same: a condition, and a log where there are several."""

    name: str
    rows: Sequence[int]  # Of the runs


def settings_of(runs: Sequence[Run]) -> list[Setting]:
    """Group runs by condition, and by log where there are several."""
    num_logs = len({run.manifest.log.name for run in runs})
    groups: dict[str, list[int]] = {}
    for row, run in enumerate(runs):
        condition = " + ".join(map(str, run.manifest.conditions)) or CLEAR
        log = visible(run.manifest.log.name)
        name = condition if num_logs == 1 else log if condition == CLEAR else f"{log}, {condition}"
        groups.setdefault(name, []).append(row)
    return [Setting(name, rows) for name, rows in groups.items()]


def scoreboard(runs: Sequence[Run], labels: Sequence[str]) -> dict[str, Any]:
    """Join the scores of all runs by metric, class, slice and matching.

    Returns `boards`, the primary metrics of the first class, one a matching; `summaries`, the same of several runs as
    one table for each of the `settings`; `parts`, metrics of the first class by slice, as tables with a column a run;
    `map`, F1 by setting; all `lines`; and the labels of runs that are `unscored`.
    """
    scored = [(run.folder / "scores.json").is_file() for run in runs]
    columns = [{score.key: score for score in run.scores} if has else {} for run, has in zip(runs, scored, strict=True)]
    lines = []
    for key in dict.fromkeys(key for column in columns for key in column):
        cells = [_cell(column.get(key)) for column in columns]
        lines.append(Line(key[0], PRIMARY.get(key[0], key[0]), *key[1:], cells))
    settings = settings_of(runs)
    first = next((line.class_ for line in lines if line.metric in PRIMARY and line.slice == "all"), "")
    return {
        "boards": _boards(lines) if len(runs) == 1 else [],
        "class_": first,
        "settings": settings,
        "summaries": [] if len(runs) == 1 else [_summary(columns, first, setting, runs) for setting in settings],
        "parts": [_parts(lines, columns, first, setting, runs) for setting in settings],
        "map": _map(runs, columns, first, settings),
        "lines": lines,
        "unscored": [label for label, has in zip(labels, scored, strict=True) if not has],
    }


def _cell(score: Score | None) -> Cell:
    if score is None:
        return Cell()
    whole = isinstance(score.value, int) or score.metric in WHOLE
    ratio = score.unit == "1" and not whole
    share = min(max(float(score.value), 0.0), 1.0) if ratio and score.value is not None else None
    counts = {name: f"{name} {number(n, 0 if float(n).is_integer() else 3)}" for name, n in score.counts.items()}
    short = [counts[name] for name in _CARD_COUNTS if name in counts and score.value is not None]
    unit = "" if score.unit == "1" else score.unit
    text = number(score.value, 0 if whole else 3)
    return Cell(text, unit, score.reason or "", share, " · ".join(counts.values()), " · ".join(short), shade(share))


def _boards(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """Group the primary metrics of the first class by matching; `reason` says why a whole board is empty."""
    groups: dict[tuple[str, str], list[Line]] = {}
    for line in lines:
        if line.metric in PRIMARY and line.slice == "all":
            groups.setdefault((line.class_, line.matching), []).append(line)
    first, order, boards = next(iter(groups), ("", ""))[0], list(PRIMARY), []
    for (class_, matching), group in groups.items():
        if class_ == first:
            reasons = {cell.reason for line in group for cell in line.cells}
            reason = reasons.pop() if len(reasons) == 1 else ""
            ranked = sorted(group, key=lambda line: order.index(line.metric))
            boards.append({"class_": class_, "matching": matching, "lines": ranked, "reason": reason})
    return boards


Columns = Sequence[dict[tuple[str, str, str, str], Score]]


def _find(column: dict[tuple[str, str, str, str], Score], metric: str, class_: str, space: str) -> Score | None:
    """Return the first score of the whole in a space."""
    return next(
        (s for key, s in column.items() if key[:3] == (metric, class_, "all") and key[3].startswith(space)), None
    )


def _summary(columns: Columns, class_: str, setting: Setting, runs: Sequence[Run]) -> dict[str, Any]:
    """Return one table: a row a run, its metrics by space; what no run has is left out, the best are marked."""
    groups, table = list[dict[str, Any]](), [list[Cell]() for _ in setting.rows]
    notes = []
    for space, name in SPACES.items():
        found = {m: [_find(columns[row], m, class_, space) for row in setting.rows] for m in _SUMMARY}
        shown = {m: own for m, own in found.items() if any(score and score.value is not None for score in own)}
        matchings = dict.fromkeys(score.matching for own in shown.values() for score in own if score)
        if not shown:
            continue
        groups.append({"name": name, "titles": [_SHORT.get(m, PRIMARY[m]) for m in shown]})
        notes.append(f"{name}: matched by {' or '.join(matchings)}")
        for metric, own in shown.items():
            values = [score.value for score in own if score and score.value is not None]
            best = (min if metric in _LOWER else max)(values)
            for cells, score in zip(table, own, strict=True):
                cell = _cell(score)
                is_best = len(set(values)) > 1 and score is not None and score.value == best
                cells.append(Cell(**{**vars(cell), "best": is_best}))
    rows = [(visible(runs[row].manifest.pipeline), cells) for row, cells in zip(setting.rows, table, strict=True)]
    return {"setting": setting.name, "groups": groups, "rows": rows, "notes": notes}


def _parts(
    lines: Sequence[Line], columns: Columns, class_: str, setting: Setting, runs: Sequence[Run]
) -> dict[str, Any]:
    """Return metrics by slice (distance, visibility, sensor, region) and by class, in each run's own space, a table a
    metric with a row a slice; what no run has is left out.
    """
    native = [next((key[3] for key in columns[row] if key[0] in PRIMARY), "") for row in setting.rows]
    tables = []
    for metric in OF_SLICES:
        found: dict[tuple[str, str], list[Cell]] = {}
        for line in lines:
            part = ("class", line.class_) if line.slice == "all" else tuple(_split(line.slice))
            if line.metric != metric or (line.slice != "all" and line.class_ != class_):
                continue
            cells = found.setdefault((part[0], part[1]), [Cell()] * len(setting.rows))
            for at, row in enumerate(setting.rows):
                if line.matching == native[at]:
                    cells[at] = line.cells[row]
        kept = {part: cells for part, cells in found.items() if any(cell.share is not None for cell in cells)}
        kinds = dict.fromkeys(kind for kind, _ in kept)
        groups = [(kind, [(name, cells) for (k, name), cells in kept.items() if k == kind]) for kind in kinds]
        if groups:
            tables.append({"metric": metric, "title": PRIMARY[metric], "groups": groups})
    pipelines = [visible(runs[row].manifest.pipeline) for row in setting.rows]
    return {"setting": setting.name, "pipelines": pipelines, "tables": tables}


def _split(part: str) -> Iterator[str]:
    """Split `range 0-10 m` into its kind and the rest."""
    if part in _OF_LATENCY:
        yield from ("latency", part)
        return
    kind, _, rest = part.partition(" ")
    yield from (kind, rest) if rest else ("part", part)


def _map(runs: Sequence[Run], columns: Columns, class_: str, settings: Sequence[Setting]) -> dict[str, Any] | None:
    """Return F1 by pipeline and setting, as a table of an experiment is shown; `None` where there is one setting, or a
    pipeline has several runs in one, which would have to be added up.
    """
    if len(settings) < 2:
        return None
    place: dict[tuple[str, int], int] = {}
    for at, setting in enumerate(settings):
        for row in setting.rows:
            if (key := (visible(runs[row].manifest.pipeline), at)) in place:
                return None
            place[key] = row
    lines = []
    for space, name in SPACES.items():
        for pipeline in dict.fromkeys(pipeline for pipeline, _ in place):
            figures = []
            for at in range(len(settings)):
                run = place.get((pipeline, at))
                score = None if run is None else _find(columns[run], "f1", class_, space)
                figures.append(
                    Figure(None) if score is None
                    else Figure(score.value, score.reason, {}, None, score.low, score.high)
                )  # fmt: skip
            if any(figure.value is not None for figure in figures):
                lines.append(ResultLine(pipeline, name, tuple(figures)))
    names = tuple(Column(setting.name) for setting in settings)
    table = ResultTable("f1_by_condition", "F1 by condition, %", names, tuple(lines), is_map=True)
    board: dict[str, Any] = result_view(Results("", (), (table,)))["boards"][0]
    return board if lines else None
