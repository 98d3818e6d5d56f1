"""Figures for papers: SVG and PNG of runs side by side, and of a robustness suite; equal inputs give equal bytes.

What was measured on the host's clock is kept apart, in the folder `timing`. Drawn by matplotlib (extra `figures`).
"""

import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fbench.replay.contracts.errors import ConfigError, MissingPackageError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.scores import Score
from fbench.replay.runs.folder import Run
from fbench.reports.html.overview import run_labels
from fbench.reports.html.records import LatencyTable, read_record, visible
from fbench.reports.tables import TIMING, FigureRow, read_results, write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#999999")  # Okabe and Ito
_STYLE: Any = {  # matplotlib types each of its keys
    "svg.hashsalt": "fbench", "text.parse_math": False, "font.size": 8, "legend.fontsize": 7, "legend.frameon": False,
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "axes.axisbelow": True, "grid.alpha": 0.3,
    "savefig.dpi": 200,
}  # fmt: skip
_WIDTH_IN, _HEIGHT_IN = 3.5, 2.4  # A column of a paper
FORMS: Mapping[str, Mapping[str, str | None]] = {"svg": {"Date": None}, "png": {}}
_SHARES = (-0.03, 1.03)  # Of an axis; what is 0 or 1 isn't cut off
_MAX_LABEL = 40
_STEP = re.compile(r"(.+) (clear|[1-5])")
_CURVES = "severity_curves"


@dataclass(frozen=True, eq=False)
class Curve:
    """Precision over recall of a run's detections at falling thresholds of their score."""

    recall: Float64  # (U,) rising
    precision: Float64  # (U,)


def draw_runs(runs: Sequence[Run], curves: Sequence[Curve | None], folder: Path) -> list[Path]:
    """Draw F1 by class and by distance, precision over recall, and latency by stage of runs side by side; return the
    paths. `curves`: one a run, `None` where results have no scores. Raises ConfigError where there is nothing to draw
    or nothing can be written; MissingPackageError without matplotlib; RunError where a run is damaged.
    """
    labels = [shorten(label) for label in run_labels(runs)]
    scored = [(label, _native(run)) for label, run in zip(labels, runs, strict=True)]
    classes = [(label, {s.class_: s for s in rows if s.slice == "all"}) for label, rows in scored]
    ranges = [(label, {s.slice[6:]: s for s in rows if s.slice.startswith("range ")}) for label, rows in scored]
    known = [(label, curve) for label, curve in zip(labels, curves, strict=True) if curve is not None]
    tables = [(label, read_record(run, "latency.json", LatencyTable)) for label, run in zip(labels, runs, strict=True)]
    timed = [(label, table) for label, table in tables if table and any(stage.mean_ms for stage in table.stages)]
    paths = []
    if any(rows for _, rows in classes):
        paths += _save(folder / "f1_by_class", partial(_draw_scores, classes, ""))
    if any(rows for _, rows in ranges):
        paths += _save(folder / "f1_by_distance", partial(_draw_scores, ranges, "Distance"))
    if known:
        paths += _save(folder / "precision_recall", partial(_draw_curves, known))
    if timed:
        paths += _save(folder / TIMING / "latency", partial(_draw_latency, timed))
    if not paths:
        raise ConfigError("there is nothing to draw: the runs have neither scores nor latencies; fbench score them")
    return paths


def draw_suite(results: Path, folder: Path) -> list[Path]:
    """Draw F1 over severity, by condition, of the `results.json` of `fbench robust`; 0 is clear weather on the logs
    that the condition fits. Return the paths. Raises as `draw_runs`.
    """
    found: dict[str, dict[str, dict[int, FigureRow]]] = {}
    for row in read_results(results).get(_CURVES, ()):
        if match := _STEP.fullmatch(row.name):
            lines = found.setdefault(shorten(match[1]), {})
            lines.setdefault(row.column, {})[int(match[2].replace("clear", "0"))] = row
    if not found:
        raise ConfigError(f"{results}: there is nothing to draw: no condition has several severities")
    return _save(folder / "robustness", partial(_draw_robustness, found))


def _native(run: Run) -> list[Score]:
    """F1 in the run's own space that has a value."""
    scores = run.scores if (run.folder / "scores.json").is_file() else []
    rows = [score for score in scores if score.metric == "f1"]
    return [score for score in rows if score.matching == rows[0].matching and score.value is not None]


def shorten(label: str, length: int = _MAX_LABEL) -> str:
    """Return a name in one line, cut off where it is too long."""
    text = " ".join(visible(label).split())
    return text if len(text) <= length else f"{text[: length - 1]}…"


def _save(path: Path, draw: Callable[["Figure"], None]) -> list[Path]:
    """Draw a figure and write it in all forms."""
    paths = [path.with_name(f"{path.name}.{form}") for form in FORMS]
    with style("--figures") as new_figure:
        figure = new_figure()
        draw(figure)
        for out, (form, metadata) in zip(paths, FORMS.items(), strict=True):
            write_whole(out, partial(figure.savefig, format=form, metadata=dict(metadata)))
    return paths


@contextmanager
def style(option: str) -> Iterator[Callable[[], "Figure"]]:
    """Set the style, whatever the user's own is, and give a maker of figures. Raises MissingPackageError naming what
    asked for it.
    """
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingPackageError(f"{option} needs matplotlib; pip install 'fbench[figures]'") from error
    with matplotlib.rc_context(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)  # of names from data
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield lambda: Figure(figsize=(_WIDTH_IN, _HEIGHT_IN), layout="constrained")


def _draw_scores(groups: Sequence[tuple[str, Mapping[str, Score]]], x_label: str, figure: "Figure") -> None:
    """Draw a dot for each run beside each other, with the interval where there is one."""
    axes, names = figure.add_subplot(), list(dict.fromkeys(name for _, rows in groups for name in rows))
    for number, (label, rows) in enumerate(groups):
        shift = 0.6 * ((number + 0.5) / len(groups) - 0.5)
        own = [(at + shift, rows[name]) for at, name in enumerate(names) if name in rows]
        color = _COLORS[number % len(_COLORS)]
        axes.plot([x for x, _ in own], [score.value or 0.0 for _, score in own], "o", ms=4, color=color, label=label)
        for x, score in own:
            if score.low is not None and score.high is not None:
                axes.plot([x, x], [score.low, score.high], "-", lw=1.2, color=color)
    axes.set_xticks(range(len(names)), [shorten(name) for name in names], rotation=30 if len(names) > 4 else 0)
    axes.set(ylim=_SHARES, ylabel="F1", xlabel=x_label)
    _add_legend(axes, len(groups))


def _draw_curves(curves: Sequence[tuple[str, Curve]], figure: "Figure") -> None:
    axes = figure.add_subplot()
    for number, (label, curve) in enumerate(curves):
        axes.plot(curve.recall, curve.precision, lw=1.2, color=_COLORS[number % len(_COLORS)], label=label)
    axes.set(xlim=(0, 1.02), ylim=_SHARES, xlabel="Recall", ylabel="Precision")
    _add_legend(axes, len(curves))


def _draw_latency(tables: Sequence[tuple[str, LatencyTable]], figure: "Figure") -> None:
    """Stack the means of the stages in front of the mean of whole frames, which is shorter where stages run side by
    side, and the 95th percentile of whole frames and the budgets.
    """
    axes = figure.add_subplot()
    names = list(dict.fromkeys(stage.stage for _, table in tables for stage in table.stages if stage.stage != "total"))
    start = [0.0] * len(tables)
    for number, name in enumerate(names):
        means = [next((s.mean_ms or 0.0 for s in table.stages if s.stage == name), 0.0) for _, table in tables]
        axes.barh(range(len(tables)), means, 0.6, start, color=_COLORS[number % len(_COLORS)], label=shorten(name))
        start = [left + mean for left, mean in zip(start, means, strict=True)]
    of_frames = [next((s.mean_ms or 0.0 for s in t.stages if s.stage == "total"), 0.0) for _, t in tables]
    axes.barh(range(len(tables)), of_frames, 0.8, fill=False, edgecolor="k", lw=0.8, label="whole frame, mean")
    is_parallel = any(stack > 1.01 * whole for stack, whole in zip(start, of_frames, strict=True))
    wholes = [next((s.p95_ms for s in table.stages if s.stage == "total"), None) for _, table in tables]
    known = [(p95, at) for at, p95 in enumerate(wholes) if p95 is not None]
    axes.plot([p95 for p95, _ in known], [at for _, at in known], "k|", ms=10, label="whole frame, p95")
    for budget_ms in dict.fromkeys(table.budget_ms for _, table in tables):
        axes.axvline(budget_ms, color="k", ls=":", lw=1, label=f"budget {budget_ms:g} ms")
    axes.set_yticks(range(len(tables)), [label for label, _ in tables])
    axes.set(xlabel=f"Mean time, ms{'; stages run side by side' if is_parallel else ''}", xlim=(0, None))
    axes.invert_yaxis()
    figure.legend(loc="outside lower center", ncols=3)


def _draw_robustness(found: Mapping[str, Mapping[str, Mapping[int, FigureRow]]], figure: "Figure") -> None:
    """Draw each condition's lines of the pipelines, severity 0 being clear weather, with bands for the intervals."""
    columns = min(3, len(found))
    rows = -(-len(found) // columns)
    figure.set_size_inches(_WIDTH_IN * columns * 0.7 + 0.8, _HEIGHT_IN * rows * 0.8 + 0.5)
    pipelines = list(dict.fromkeys(name for lines in found.values() for name in lines))
    for number, (condition, lines) in enumerate(found.items(), 1):
        axes = figure.add_subplot(rows, columns, number)
        for pipeline, points in lines.items():
            color = _COLORS[pipelines.index(pipeline) % len(_COLORS)]
            own = [(at, row) for at, row in sorted(points.items()) if row.value is not None]
            x = [at for at, _ in own]
            axes.plot(x, [row.value or 0.0 for _, row in own], "o-", ms=3, lw=1.2, color=color, label=shorten(pipeline))
            sure = [(at, row.low, row.high) for at, row in own if row.low is not None and row.high is not None]
            if len(sure) > 1:
                at, low, high = zip(*sure, strict=True)
                axes.fill_between(at, low, high, color=color, alpha=0.15, lw=0)
        axes.set_title(condition, fontsize=8)
        axes.set(ylim=_SHARES, xlabel="Severity" if number > len(found) - columns else "")
        axes.set_ylabel("F1" if number % columns == 1 or columns == 1 else "")
        if number == 1:
            _add_legend(axes, len(pipelines))


def _add_legend(axes: "Axes", num: int) -> None:
    """Name the lines, where there is more than one."""
    if num > 1:
        axes.legend(loc="best")
