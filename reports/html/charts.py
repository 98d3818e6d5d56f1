"""Pages of curves drawn as SVG, with their numbers in a table: sweeps over rates, and camera detectors side by side."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fbench.replay.data.files import replace_text
from fbench.reports.html.records import PACKAGE, environment, number, read_style

_LEFT, _RIGHT, _TOP, _BOTTOM = 52.0, 452.0, 14.0, 196.0
"""Ends of the axes in the drawing [px]."""
_MOST_TICKS = 5
_MOST_DOTS = 30  # Points of a curve from which on it is a line alone


@dataclass(frozen=True)
class Curve:
    """One line of a chart."""

    name: str
    points: Sequence[tuple[float, float | None]]
    """By place on the horizontal axis, in any order; `None`: there is no value."""


@dataclass(frozen=True)
class Axis:
    """A horizontal axis."""

    name: str
    ticks: Sequence[tuple[float, str]] = ()
    """Places and their labels; empty: as fits the curves, from 0 on."""
    is_log: bool = False
    limit: float | None = None
    """A place that is marked, as far as it lies within."""


@dataclass(frozen=True)
class Chart:
    """Curves on one pair of axes."""

    title: str
    axis: Axis
    curves: Sequence[Curve]
    limit: float | None = None
    """Drawn across as a dashed line."""


@dataclass(frozen=True)
class Table:
    """Numbers as text: `header` has one more name than there are columns, that of the rows."""

    header: Sequence[str]
    rows: Sequence[tuple[str, Sequence[str]]]


@dataclass(frozen=True)
class Page:
    """All that a page shows."""

    kind: str
    """What it is about, as `sweep over rates`."""
    title: str
    facts: Sequence[tuple[str, str]]
    """What else ran, as names with values."""
    charts: Sequence[Chart]
    table: Table
    notes: Sequence[str] = ()


def write_page(out: Path, page: Page) -> None:
    """Write one page that loads nothing, equal byte by byte for equal content."""
    content = environment(PACKAGE).get_template("charts.html").render(
        page=page, charts=[_draw(chart) for chart in page.charts],
        style=read_style("style.css", "charts.css"),
        frame={"left": _LEFT, "right": _RIGHT, "top": _TOP, "bottom": _BOTTOM},
    )  # fmt: skip
    replace_text(out, content)


def _draw(chart: Chart) -> dict[str, Any]:
    """Return what the template draws, in px: curves as `runs` of points without a gap, ticks, and limits."""
    axis, values = chart.axis, [y for curve in chart.curves for _, y in curve.points if y is not None]
    step, low, high = _choose_ticks(min([0.0, *values]), max([0.0, *values, chart.limit or 0.0]))
    places = [place for place, _ in axis.ticks] or [x for curve in chart.curves for x, _ in curve.points]
    x_ticks = axis.ticks
    if not x_ticks:
        x_step, x_low, x_high = _choose_ticks(0.0, max([0.0, *places]))
        x_ticks = [(i * x_step, number(i * x_step, _digits(x_step))) for i in range(x_low, x_high + 1)]
        places = [place for place, _ in x_ticks]
    first, last = (math.log(end) if axis.is_log else end for end in (min(places), max(places)))

    def x(place: float) -> float:
        share = ((math.log(place) if axis.is_log else place) - first) / (last - first) if last > first else 0.5
        return round(_LEFT + 16 + share * (_RIGHT - _LEFT - 32), 1)

    def y(value: float) -> float:
        return round(_BOTTOM - (value - low * step) / ((high - low) * step) * (_BOTTOM - _TOP), 1)

    curves = []
    for curve in chart.curves:
        runs: list[list[tuple[float, float]]] = [[]]
        for place, value in sorted(curve.points, key=lambda point: point[0]):
            if value is not None:
                runs[-1].append((x(place), y(value)))
            elif runs[-1]:
                runs.append([])
        curves.append({"name": curve.name, "runs": runs, "dots": len(curve.points) < _MOST_DOTS})
    inside = axis.limit is not None and min(places) <= axis.limit <= max(places)
    return {
        "title": chart.title,
        "axis": axis.name,
        "curves": curves,
        "x_ticks": [(x(place), text) for place, text in x_ticks],
        "y_ticks": [(y(i * step), number(i * step, _digits(step))) for i in range(low, high + 1)],
        "limit": None if chart.limit is None else y(chart.limit),
        "limit_x": x(axis.limit) if inside and axis.limit is not None else None,
    }


def texts(values: Sequence[float | None]) -> list[str]:
    """Return values as text, with one digit more than the ticks of an axis for them would have."""
    known = [value for value in values if value is not None]
    return [number(value, _digits(_choose_ticks(min([0.0, *known]), max([0.0, *known]))[0]) + 1) for value in values]


def _digits(step: float) -> int:
    return max(0, -math.floor(math.log10(step)))


def _choose_ticks(low: float, high: float) -> tuple[float, int, int]:
    """Return a step of 1, 2 or 5 times a power of ten, and the first and last multiple of it that hold all values."""
    span = (high - low) or 1.0
    power = 10.0 ** math.floor(math.log10(span / _MOST_TICKS))
    step = next(power * factor for factor in (1, 2, 5, 10) if span <= power * factor * _MOST_TICKS)
    first = math.floor(low / step)
    return step, first, max(first + 1, math.ceil(high / step))
