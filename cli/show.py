"""Tables on the terminal, JSON for machines, and faults as text."""

import io
import json
import os
import signal
import sys
import traceback
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from typing import Any, BinaryIO, TextIO

from rich.console import Console
from rich.table import Table
from rich.text import Text
from typer import Exit

from fbench.replay.data.scores import Results, Score, format_figure
from fbench.replay.runs.secrets import without_secrets

_COUNTS = ("idsw",)
_SHOWN = ("f1", "precision", "recall", "mota", "mota_no_fp", "motp", "idsw", "idf1", "hota")


class _Console(Console):
    """Shows names from data as they are: they can't steer the terminal, and their brackets are no markup."""

    def render_str(self, text: str, **how: Any) -> Text:
        """Return a text as it is printed."""
        return super().render_str("\n".join(map(printable, text.split("\n"))), **how)

    def on_broken_pipe(self) -> None:
        """End the command; rich and typer would with exit code 1, which means no."""
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # for what is still buffered
        raise Exit(128 + signal.SIGPIPE)


def printable(text: str) -> str:
    """Return a text with a space for each character that can't be printed."""
    return "".join(c if c.isprintable() else " " for c in text)


class _PluginOutput(io.TextIOBase):
    """Passes on what a plug-in prints, with a space for what would steer a terminal."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    @property
    def buffer(self) -> BinaryIO:
        """The file below, for bytes."""
        return self._file.buffer

    def write(self, text: str) -> int:
        self._file.write("".join(c if c.isprintable() or c in "\n\t" else " " for c in text))
        return len(text)

    def flush(self) -> None:
        self._file.flush()

    def fileno(self) -> int:
        return self._file.fileno()

    def isatty(self) -> bool:
        return self._file.isatty()


@contextmanager
def plugin_output() -> Iterator[None]:
    """Let what plug-ins print go to stderr, not between the lines of --json, while the `with` block runs."""
    if sys.stderr is None:  # closed
        yield
        return
    with redirect_stdout(_PluginOutput(sys.stderr)), redirect_stderr(sys.stdout):
        yield


def console() -> Console:
    """A console that neither highlights nor breaks lines of what isn't a terminal, and has no markup."""
    plain = _Console(highlight=False, markup=False, emoji=False)
    return plain if plain.is_terminal else _Console(highlight=False, markup=False, emoji=False, width=120)


def say(*lines: str) -> None:
    """Print lines, whatever names in them the data gave; a terminal breaks them where it likes."""
    out = console()
    for line in lines:
        out.print(line.replace("\n", " "), soft_wrap=True)


def make_table(*columns: str, right: Collection[str] = ()) -> Table:
    """Return a table without lines; the columns in `right` hold numbers."""
    table = Table(box=None, pad_edge=False)
    for column in columns:
        table.add_column(column, justify="right" if column in right else "left")
    return table


def print_json(content: object) -> None:
    """Print a value as JSON; numbers that JSON doesn't have are an error of ours."""
    try:
        print(json.dumps(content, indent=1, allow_nan=False), flush=True)  # noqa: T201
    except BrokenPipeError:
        console().on_broken_pipe()


def show_traceback(error: BaseException) -> None:
    """Write the traceback of an error to stderr, without credentials."""
    sys.stderr.write(without_secrets("".join(traceback.format_exception(error))))


def number(metric: str, value: float | None, unit: str) -> str:
    """A score for people: three decimals and the unit, counts without."""
    if value is None:
        return "–"
    if metric in _COUNTS:
        return f"{value:.0f}"
    return f"{value:.3f}" if unit in ("1", "iou") else f"{value:.3f} {unit}"


def interval_text(score: Score, digits: int = 3) -> str:
    """The confidence interval, such as ` [0.837, 0.962]`; nothing where there is none."""
    if score.low is None or score.high is None:
        return ""
    return f" [{score.low:.{digits}f}, {score.high:.{digits}f}]"


def primary(scores: Sequence[Score]) -> list[Score]:
    """The rows worth showing first: all vehicles as one class, in the run's own space and in the image."""
    return [s for s in scores if s.metric in _SHOWN and s.class_ == "vehicle" and s.slice == "all"]


def score_table(scores: Sequence[Score]) -> Table:
    """One line a metric, one column a way of matching."""
    rows = primary(scores)
    native = rows[0].matching if rows else ""
    matchings = list(dict.fromkeys(s.matching for s in rows if s.value is not None or s.matching == native))
    table = make_table("metric", *matchings, right=matchings)
    for metric in dict.fromkeys(s.metric for s in rows):
        digits = 0 if metric in _COUNTS else 3
        own = [s for s in rows if s.metric == metric]
        cells = {s.matching: number(metric, s.value, s.unit) + interval_text(s, digits) for s in own}
        table.add_row(metric, *(cells.get(matching, "") for matching in matchings))
    return table


def null_reasons(scores: Iterable[Score]) -> list[str]:
    """Why numbers are missing, each reason once with its metrics."""
    return [f"{metrics}: {reason}" for reason, metrics in _by_reason((s.reason, s.metric) for s in scores)]


def interval_reasons(scores: Iterable[Score]) -> list[str]:
    """Why numbers that were to have an interval have none, each reason once with its metrics."""
    without = ((s.interval, s.metric) for s in scores if s.low is None)
    return [f"no interval of {metrics}: {reason}" for reason, metrics in _by_reason(without)]


def _by_reason(pairs: Iterable[tuple[str | None, str]]) -> list[tuple[str, str]]:
    found: dict[str, list[str]] = {}
    for reason, metric in pairs:
        if reason is not None and metric not in found.setdefault(reason, []):
            found[reason].append(metric)
    return [(reason, ", ".join(metrics)) for reason, metrics in found.items()]


def score_notes(scores: Sequence[Score]) -> list[str]:
    """Why primary numbers in the run's own space are missing, or have no interval."""
    rows = [s for s in primary(scores) if s.matching == scores[0].matching]
    return [f"– {line}" for line in (*null_reasons(rows), *interval_reasons(rows))]


def latency_table(latency: dict[str, Any]) -> Table:
    """One line a stage, in milliseconds."""
    names = {"p50 ms": "p50_ms", "p95 ms": "p95_ms", "p99 ms": "p99_ms", "p99.9 ms": "p999_ms", "max ms": "max_ms"}
    names["cpu ms"] = "cpu_mean_ms"
    rare = ("p99.9 ms", "cpu ms")
    names = {
        n: k for n, k in names.items() if n not in rare or any(row.get(k) is not None for row in latency["stages"])
    }
    table = make_table("stage", *names, right=[*names])
    for row in latency["stages"]:
        cells = (row.get(key) for key in names.values())
        table.add_row(row["stage"], *("–" if c is None else f"{c:.2f}" for c in cells))
    return table


def fault_lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """One line a kind of fault that was met, from the rows of a `FaultLog`; one a topic of a sensor that isn't read."""
    lines = []
    for row in (row for row in rows if row["count"]):
        head, places = f"fault: {row['code']} {row['text']}: ", row["places"]
        if row["code"] == "LOG013":
            lines += [head + place for place in places]
        else:
            lines.append(f"{head}{row['count']}" + (f" (first: {places[0]})" if places else ""))
    return lines


_ON_TERMINAL = (
    "accuracy",
    "ablation",
    "robustness",
    "robustness_aggregates",
    "robustness_f1_change",
    "recovery",
    "latency",
)
"""The others are in the files."""


def show_results(results: Results) -> None:
    """Print what ran, the main tables, and what went wrong."""
    out = console()
    for table in (*results.tables, *results.measured):
        if table.name not in _ON_TERMINAL or not table.lines or not table.columns:
            continue
        out.print(f"\n{table.title}", style="bold")
        names = ["", ""] if table.has_spaces else [""]
        grid = make_table(*names, *(column.name for column in table.columns), right=[c.name for c in table.columns])
        for line in table.lines:
            cells = (format_figure(f, c.kind) for f, c in zip(line.figures, table.columns, strict=True))
            grid.add_row(*((line.name, line.space) if table.has_spaces else (line.name,)), *cells)
        out.print(grid)
        if table.name != "latency":  # a stage that a pipeline hasn't needs no reason
            say(*(f"– {text}" for text in table.reasons))
        out.print()
    facts = dict(results.facts)
    say(*(f"{name}: {facts[name]}" for name in ("camera detector", "frames") if name in facts), *results.problems)


def show_summary(results: Results) -> None:
    """Print a line for each configuration in the space of its own boxes: F1 in clear weather and in the worst other
    weather, with intervals, and MOTA; then what failed. The rest is in the files.
    """
    tables = {table.name: table for table in results.tables}
    accuracy, by_condition = tables["accuracy"], tables["f1_by_condition"]
    known = {(line.name, line.space): line for line in by_condition.lines}
    names = [column.name for column in by_condition.columns]
    grid = make_table("pipeline", "boxes", "F1 % clear", "F1 % worst weather", "MOTA %", right=["MOTA %"])
    for line in accuracy.lines:
        if line.space != ("image" if "2d" in line.name else "3D"):
            continue
        figures = dict(zip(names, known[line.name, line.space].figures, strict=True))
        worst = min(
            (name for name, f in figures.items() if name != "clear" and f.value is not None),
            key=lambda name: (figures[name].value or 0.0, name), default="",
        )  # fmt: skip
        shown = f"{format_figure(figures[worst], 'share')} {worst}" if worst else "–"
        clear, mota = (format_figure(figure, "share") for figure in line.figures[:2])
        grid.add_row(line.name, line.space, clear, shown, mota.partition(" ")[0])
    console().print(grid)
    has_intervals = any(line.figures[0].low is not None for line in accuracy.lines)
    intervals = "; in brackets: 95 % of resamples" if has_intervals else ""
    say(f"F1: 100 if nothing is missed and nothing else reported{intervals}. MOTA: of tracks.")
    say(*(text for text in results.problems if not text.startswith("missing:")))
