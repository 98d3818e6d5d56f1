"""Tables and curves of an experiment as the page shows them."""

from typing import Any

from fbench.replay.data.scores import Curves, Figure, Kind, Results, ResultTable, format_figure, format_number
from fbench.reports.html.records import DASH, shade


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
    head = {"title": table.title, "notes": table.notes, "has_spaces": table.has_spaces, "has_published": any(has),
            "is_map": table.is_map and len(columns) > 1}  # fmt: skip
    return {**head, "columns": columns, "lines": lines}


def _figure(figure: Figure, kind: Kind) -> dict[str, Any]:
    """One figure as text; `published` is what the source system's authors give, empty where they give nothing. `shade`
    and `at`, with the ends of its interval, are its place from 0 to 1, in tenths and in percent.
    """

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
        "shade": shade(figure.value),
        "at": None if figure.value is None else round(100 * min(1.0, max(0.0, figure.value)), 2),
        "low": None if figure.low is None else round(100 * min(1.0, max(0.0, figure.low)), 2),
        "high": None if figure.high is None else round(100 * min(1.0, max(0.0, figure.high)), 2),
    }
