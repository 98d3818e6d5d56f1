"""Scores and tables of an experiment as the page shows them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from fbench.replay.data.scores import Curves, Figure, Kind, Results, ResultTable, Score, format_figure, format_number
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


def scoreboard(runs: Sequence[Run], labels: Sequence[str]) -> dict[str, Any]:
    """Join the scores of all runs by metric, class, slice and matching.

    Returns `boards`, the primary metrics of the first class, one a matching; `parts`, recall, precision and F1 of the
    first board by slice (distance, visibility, sensor, region), one run after the other; all `lines`; and the labels of
    runs that are `unscored`.
    """
    scored = [(run.folder / "scores.json").is_file() for run in runs]
    columns = [{score.key: score for score in run.scores} if has else {} for run, has in zip(runs, scored, strict=True)]
    lines = []
    for key in dict.fromkeys(key for column in columns for key in column):
        cells = [_cell(column.get(key), has) for column, has in zip(columns, scored, strict=True)]
        lines.append(Line(key[0], PRIMARY.get(key[0], key[0]), *key[1:], cells))
    unscored = [label for label, has in zip(labels, scored, strict=True) if not has]
    return {"boards": _boards(lines), "parts": _parts(lines), "lines": lines, "unscored": unscored}


def _cell(score: Score | None, scored: bool) -> Cell:
    if score is None:
        return Cell(DASH, reason="this run has no such score" if scored else "not scored")
    whole = isinstance(score.value, int) or score.metric in _WHOLE
    ratio = score.unit == "1" and not whole
    share = min(max(float(score.value), 0.0), 1.0) if ratio and score.value is not None else None
    counts = {name: f"{name} {number(n, 0 if float(n).is_integer() else 3)}" for name, n in score.counts.items()}
    short = [counts[name] for name in _CARD_COUNTS if name in counts and score.value is not None]
    unit = "" if score.unit == "1" else score.unit
    text = number(score.value, 0 if whole else 3)
    return Cell(text, unit, score.reason or "", share, " · ".join(counts.values()), " · ".join(short))


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


def _parts(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """Group recall, precision and F1 of the first class by slice, without slices in which there is nothing."""
    of = next(((line.class_, line.matching) for line in lines if line.metric in PRIMARY), None)
    groups: dict[str, dict[str, Line]] = {}
    for line in lines:
        if line.metric in _OF_SLICES and line.slice != "all" and (line.class_, line.matching) == of:
            groups.setdefault(line.slice, {})[line.metric] = line
    parts = []
    for name, group in groups.items():
        num_runs, found = len(next(iter(group.values())).cells), [group.get(metric) for metric in _OF_SLICES]
        cells = [Cell(DASH) if line is None else line.cells[run] for run in range(num_runs) for line in found]
        if any(cell.text != DASH for cell in cells):
            parts.append({"slice": name, "cells": cells})
    return parts


def result_view(results: Results) -> dict[str, Any]:
    """Turn the numbers of an experiment into text: `facts`, `boards`, one a table, `problems`, and `curves`."""
    boards, curves = [_board(t) for t in results.tables], [_curves(c) for c in results.curves]
    return {"facts": results.facts, "boards": boards, "problems": results.problems, "curves": curves}


_LEFT, _RIGHT, _TOP, _BOTTOM = 30, 250, 8, 120
"""Of the field of a chart, in its units."""
_COLORS = 6


def _curves(curves: Curves) -> dict[str, Any]:
    """Places of points in a chart: of each line its pieces between figures that are missing, and the band of its
    interval.
    """
    width = (_RIGHT - _LEFT) / max(1, len(curves.steps) - 1)

    def at(step: int, value: float) -> str:
        return f"{_LEFT + width * step:.1f},{_BOTTOM - (_BOTTOM - _TOP) * min(1.0, max(0.0, value)):.1f}"

    lines = []
    for color, line in enumerate(curves.lines):
        known = [(i, f.value) for i, f in enumerate(line.figures) if f.value is not None]
        pieces: list[list[str]] = []
        for num, (i, value) in enumerate(known):
            if not num or known[num - 1][0] < i - 1:
                pieces.append([])
            pieces[-1].append(at(i, value))
        ends = [(i, f.low, f.high) for i, f in enumerate(line.figures) if f.low is not None and f.high is not None]
        band = [at(i, low) for i, low, _ in ends] + [at(i, high) for i, _, high in reversed(ends)]
        texts = [
            f"{step} {format_number(f.value, 'share')}" for step, f in zip(curves.steps, line.figures, strict=True)
        ]
        label = f"{line.name}: {', '.join(texts)}"
        has_band = len(ends) == len(line.figures)
        lines.append({
            "name": line.name, "color": color % _COLORS, "pieces": pieces, "band": band if has_band else [],
            "label": label,
        })  # fmt: skip
    steps = [{"name": step, "x": f"{_LEFT + width * i:.1f}"} for i, step in enumerate(curves.steps)]
    return {"title": curves.title, "steps": steps, "lines": lines}


def _board(table: ResultTable) -> dict[str, Any]:
    lines = []
    for line in table.lines:
        cells = [_figure(f, column.kind) for f, column in zip(line.figures, table.columns, strict=True)]
        lines.append({"name": line.name, "space": line.space, "cells": cells})
    has = [any(line.figures[i].published is not None for line in table.lines) for i in range(len(table.columns))]
    columns = [{"name": column.name, "has_published": own} for column, own in zip(table.columns, has, strict=True)]
    head = {"title": table.title, "notes": table.notes, "has_spaces": table.has_spaces, "has_published": any(has)}
    return {**head, "columns": columns, "lines": lines}


def _figure(figure: Figure, kind: Kind) -> dict[str, str]:
    """One figure as text; `published` is what the source system's authors give, empty where they give nothing."""

    def show(value: float | None) -> str:  # With a true minus sign
        text = format_number(value, kind)
        return text if text == DASH else text.replace("-", "\u2212")

    published = "" if figure.published is None else show(figure.published)
    counts = " · ".join(f"{name.replace('_', ' ')} {num:g}" for name, num in figure.counts.items())
    text = format_figure(figure, kind)
    return {
        "text": text if text == DASH else text.replace("-", "\u2212"),
        "published": published,
        "reason": figure.reason or "",
        "counts": counts,
    }
