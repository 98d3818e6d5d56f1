"""Tables and progress on the terminal, JSON for machines, and faults as text."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console, HighlighterType, JustifyMethod, OverflowMethod
from rich.progress import (
    BarColumn,
    DownloadColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.style import Style
from rich.table import Table
from rich.text import Text

from fbench.replay.data.scores import Results, ResultTable, Score, shown
from fbench.replay.runs.secrets import without_secrets

_COUNTS = ("idsw",)
_SHOWN = ("f1", "precision", "recall", "mota", "mota_no_fp", "motp", "idsw", "idf1", "hota")


class _Console(Console):
    """Shows names from data as they are: they can't steer the terminal, and their brackets are no markup."""

    def render_str(
        self,
        text: str,
        *,
        style: str | Style = "",
        justify: JustifyMethod | None = None,
        overflow: OverflowMethod | None = None,
        emoji: bool | None = None,
        markup: bool | None = None,
        highlight: bool | None = None,
        highlighter: HighlighterType | None = None,
    ) -> Text:
        """Return a text as it is printed."""
        shown = "".join(c if c.isprintable() or c == "\n" else " " for c in text)
        return super().render_str(
            shown, style=style, justify=justify, overflow=overflow, emoji=emoji, markup=markup, highlight=highlight,
            highlighter=highlighter,
        )  # fmt: skip


def console() -> Console:
    """A console that neither highlights nor breaks lines of what isn't a terminal, and has no markup."""
    plain = _Console(highlight=False, markup=False, emoji=False)
    return plain if plain.is_terminal else _Console(highlight=False, markup=False, emoji=False, width=120)


def print_json(content: object) -> None:
    """Print a value as JSON; numbers that JSON doesn't have are an error of ours."""
    print(json.dumps(content, indent=1, allow_nan=False))  # noqa: T201


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


def _with_interval(score: Score) -> str:
    return number(score.metric, score.value, score.unit) + interval_text(score, 0 if score.metric in _COUNTS else 3)


def primary(scores: Sequence[Score]) -> list[Score]:
    """The rows worth showing first: all vehicles as one class, in the run's own space and in the image."""
    return [s for s in scores if s.metric in _SHOWN and s.class_ == "vehicle" and s.slice == "all"]


def score_table(scores: Sequence[Score]) -> Table:
    """One line a metric, one column a way of matching."""
    rows = primary(scores)
    native = rows[0].matching if rows else ""
    matchings = list(dict.fromkeys(s.matching for s in rows if s.value is not None or s.matching == native))
    table = Table(box=None, pad_edge=False)
    table.add_column("metric")
    for matching in matchings:
        table.add_column(matching, justify="right")
    for metric in dict.fromkeys(s.metric for s in rows):
        cells = {s.matching: _with_interval(s) for s in rows if s.metric == metric}
        table.add_row(metric, *(cells.get(matching, "") for matching in matchings))
    return table


def null_reasons(scores: Sequence[Score]) -> list[str]:
    """Why numbers are missing in the run's own space, each reason once with its metrics."""
    native = scores[0].matching if scores else ""
    reasons: dict[str, list[str]] = {}
    for s in primary(scores):
        if s.matching == native and s.reason is not None and s.metric not in reasons.setdefault(s.reason, []):
            reasons[s.reason].append(s.metric)
    return [f"{', '.join(metrics)}: {reason}" for reason, metrics in reasons.items()]


def interval_reasons(scores: Sequence[Score]) -> list[str]:
    """Why numbers that were to have an interval have none, each reason once with its metrics, primary rows only."""
    native = scores[0].matching if scores else ""
    return reasons_of_intervals(row for row in primary(scores) if row.matching == native)


def reasons_of_intervals(scores: Iterable[Score]) -> list[str]:
    """Why numbers that were to have an interval have none, each reason once with its metrics."""
    found: dict[str, list[str]] = {}
    for row in scores:
        if row.interval is not None and row.low is None and row.metric not in found.setdefault(row.interval, []):
            found[row.interval].append(row.metric)
    return [f"no interval of {', '.join(metrics)}: {reason}" for reason, metrics in found.items()]


def latency_table(latency: dict[str, Any]) -> Table:
    """One line a stage, in milliseconds."""
    table = Table(box=None, pad_edge=False)
    table.add_column("stage")
    for name in ("p50", "p95", "p99", "max"):
        table.add_column(f"{name} ms", justify="right")
    for row in latency["stages"]:
        cells = (row[f"{name}_ms"] for name in ("p50", "p95", "p99", "max"))
        table.add_row(row["stage"], *("–" if c is None else f"{c:.2f}" for c in cells))
    return table


def fault_lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """One line a kind of fault that was met, from the rows of a `FaultLog`."""
    return [f"fault: {_line(row)}" for row in rows if row["count"]]


def _line(row: Mapping[str, Any]) -> str:
    first = f" (first: {row['places'][0]})" if row["places"] else ""
    return f"{row['code']} {row['text']}: {row['count']}{first}"


_ON_TERMINAL = ("accuracy", "robustness", "latency")  # The others are in the files


def show_results(results: Results, out: Console) -> None:
    """Print what ran, the main tables, and what went wrong."""
    for table in (*results.tables, *results.measured):
        if table.name in _ON_TERMINAL and table.lines and table.columns:
            _show(table, out)
    facts = dict(results.facts)
    _lines((f"{name}: {facts[name]}" for name in ("camera detector", "frames") if name in facts), out)
    _lines(results.problems, out)


def _show(table: ResultTable, out: Console) -> None:
    out.print(f"\n{table.title}", style="bold", markup=False)
    grid = Table(box=None, pad_edge=False)
    grid.add_column("")
    if table.has_spaces:
        grid.add_column("")
    for column in table.columns:
        grid.add_column(column.name, justify="right")
    for line in table.lines:
        names = (line.name, line.space) if table.has_spaces else (line.name,)
        cells = (shown(f.value, c.kind) for f, c in zip(line.figures, table.columns, strict=True))
        grid.add_row(*names, *cells)
    out.print(grid)
    if table.name != "latency":  # a stage that a pipeline hasn't needs no reason
        _lines((f"– {text}" for text in table.reasons), out)
    out.print()


def _lines(lines: Iterable[str], out: Console) -> None:
    for line in lines:
        out.print(line, markup=False, soft_wrap=True)


@contextmanager
def message_progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show how many of `total` messages are done on stderr while the `with` block runs."""
    with _progress(BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()) as progress:
        task = progress.add_task(_shown(title), total=total or None)
        yield lambda num_messages: progress.update(task, completed=num_messages)


@contextmanager
def byte_progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show how many of `total` bytes are done on stderr while the `with` block runs."""
    with _progress(BarColumn(), DownloadColumn(), TimeRemainingColumn()) as progress:
        task = progress.add_task(_shown(title), total=total)
        yield lambda num_bytes: progress.update(task, completed=num_bytes)


class ImportProgress:
    """Shows the sequence that is being imported, and how many are done."""

    def __init__(self, progress: Progress, num_sequences: int) -> None:
        self._progress = progress
        self._all = progress.add_task("sequences", total=num_sequences, visible=num_sequences > 1)
        self._one = progress.add_task("", total=None, visible=False)

    def __call__(self, name: str, done: int, total: int) -> None:
        """Tell how many items of a sequence are done."""
        self._progress.update(self._one, description=_shown(name), completed=done, total=total or None, visible=True)

    def done(self) -> None:
        """Tell that a sequence is done."""
        self._progress.advance(self._all)
        self._progress.reset(self._one, visible=False)

    @contextmanager
    def finished(self, num: int) -> Iterator[None]:
        """Tell that a sequence of `num` items is done; nothing is shown while the `with` block prints about it."""
        # How many there would be was an estimate.
        self._progress.update(self._one, completed=num, total=num or None, refresh=True)
        self._progress.advance(self._all)
        self._progress.stop()
        yield
        self._progress.reset(self._one, visible=False)
        self._progress.start()


@contextmanager
def import_progress(num_sequences: int) -> Iterator[ImportProgress]:
    """Show the progress of an import on stderr while the `with` block runs."""
    with _progress(BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()) as progress:
        yield ImportProgress(progress, num_sequences)


@contextmanager
def frame_progress(title: str) -> Iterator[Callable[[int], None]]:
    """Show a running count of frames on stderr while the `with` block runs."""
    with _progress(TextColumn("{task.completed} frames"), TimeElapsedColumn(), spins=True) as progress:
        task = progress.add_task(_shown(title), total=None)
        yield lambda num_frames: progress.update(task, completed=num_frames)


@contextmanager
def replay_progress(title: str) -> Iterator[Callable[[int, int], None]]:
    """Show how many replays are done, of how many, on stderr while the `with` block runs."""
    with _progress(BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), spins=True) as progress:
        task = progress.add_task(_shown(title), total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def _progress(*columns: ProgressColumn, spins: bool = False) -> Progress:
    """On stderr, where that is a terminal, and gone when it ends; spins where nobody knows how much there is."""
    console = Console(stderr=True)
    named = [*([SpinnerColumn()] if spins else []), TextColumn("{task.description}", markup=False)]
    return Progress(*named, *columns, console=console, transient=True, disable=not console.is_terminal)


def _shown(title: str) -> str:
    return "".join(c if c.isprintable() else " " for c in without_secrets(title))
