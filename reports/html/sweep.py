"""The page of a sweep: curves of accuracy, age and drops against the rate, drawn as SVG."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from fbench.replay.data.files import replace_text
from fbench.reports.html.records import environment, number, resource

_PACKAGE = "fbench.reports.html"
_LEFT, _RIGHT, _TOP, _BOTTOM = 52.0, 452.0, 14.0, 196.0
"""Ends of the axes in the drawing [px]."""
_MOST_TICKS = 5


@dataclass(frozen=True)
class Curve:
    """One line of a chart."""

    name: str
    values: Sequence[float | None]
    """(R,) one a rate; `None`: there is none."""


@dataclass(frozen=True)
class Chart:
    """Curves over the same rates, on one axis of values."""

    title: str
    curves: Sequence[Curve]
    limit: float | None = None
    """Drawn across as a dashed line."""


def write_sweep_page(
    out: Path, title: str, facts: Sequence[tuple[str, str]], rates: Sequence[float], limit_rate: float | None,
    charts: Sequence[Chart],
) -> None:  # fmt: skip
    """Write one page that loads nothing, equal byte by byte for equal content.

    Args:
        out: The file.
        title: The log.
        facts: What else ran, as names with values.
        rates: (R,) positive, the horizontal axis, which is logarithmic.
        limit_rate: Marked on that axis, as far as it lies within.
        charts: What is drawn.
    """
    content = environment(_PACKAGE).get_template("sweep.html").render(
        title=title, facts=facts, rates=[f"{rate:g}×" for rate in rates], limit_rate=limit_rate,
        charts=[_draw(chart, rates, limit_rate) for chart in charts],
        style=Markup(resource(_PACKAGE, "style.css")),  # noqa: S704 - part of the package
        frame={"left": _LEFT, "right": _RIGHT, "top": _TOP, "bottom": _BOTTOM},
    )  # fmt: skip
    replace_text(out, content)


def _draw(chart: Chart, rates: Sequence[float], limit_rate: float | None) -> dict[str, Any]:
    """Return what the template draws, in px: curves as `runs` of points without a gap, ticks, and limits."""
    values = [value for curve in chart.curves for value in curve.values if value is not None]
    step, low, high = _choose_ticks(min([0.0, *values]), max([0.0, *values, chart.limit or 0.0]))
    first, last = math.log(min(rates)), math.log(max(rates))

    def x(rate: float) -> float:
        share = (math.log(rate) - first) / (last - first) if last > first else 0.5
        return round(_LEFT + 16 + share * (_RIGHT - _LEFT - 32), 1)

    def y(value: float) -> float:
        return round(_BOTTOM - (value - low * step) / ((high - low) * step) * (_BOTTOM - _TOP), 1)

    digits = max(0, -math.floor(math.log10(step)))
    curves = []
    for curve in chart.curves:
        runs: list[list[tuple[float, float]]] = [[]]
        for rate, value in sorted(zip(rates, curve.values, strict=True), key=lambda pair: pair[0]):
            if value is not None:
                runs[-1].append((x(rate), y(value)))
            elif runs[-1]:
                runs.append([])
        texts = [number(value, digits + 1) for value in curve.values]
        curves.append({"name": curve.name, "runs": runs, "texts": texts})
    inside = limit_rate is not None and min(rates) <= limit_rate <= max(rates)
    return {
        "title": chart.title,
        "curves": curves,
        "x_ticks": [(x(rate), f"{rate:g}×") for rate in rates],
        "y_ticks": [(y(i * step), number(i * step, digits)) for i in range(low, high + 1)],
        "limit": None if chart.limit is None else y(chart.limit),
        "limit_x": x(limit_rate) if inside and limit_rate is not None else None,
    }


def _choose_ticks(low: float, high: float) -> tuple[float, int, int]:
    """Return a step of 1, 2 or 5 times a power of ten, and the first and last multiple of it that hold all values."""
    span = (high - low) or 1.0
    power = 10.0 ** math.floor(math.log10(span / _MOST_TICKS))
    step = next(power * factor for factor in (1, 2, 5, 10) if span <= power * factor * _MOST_TICKS)
    first = math.floor(low / step)
    return step, first, max(first + 1, math.ceil(high / step))
