"""Scores of a profile: tables for people, rows for machines."""

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from fbench.api.scores import ScoreResult
from fbench.cli.show import (
    console,
    interval_reasons,
    interval_text,
    null_reasons,
    print_json,
    reasons_of_intervals,
    score_table,
)
from fbench.replay.data.scores import Score, save_scores, score_rows

if TYPE_CHECKING:
    from fbench.metrics.profiles.remarks import Line

_MAX_COLUMNS = 6
_COLUMNS_BY_SEQUENCE = 8


def show_together(result: ScoreResult, runs: Sequence[Path], out: Path | None, as_json: bool) -> None:
    """Print the scores of several runs together, and write them where that is wanted."""
    _warn(result)
    if out is not None:
        save_scores(out, result.rows)
    if as_json:
        print_json({"runs": [str(folder) for folder in runs], "scores": score_rows(result.rows)})
        return
    shown = console()
    shown.print(result.title, markup=False)
    shown.print(score_table(result.rows))
    for line in (*null_reasons(result.rows), *interval_reasons(result.rows)):
        shown.print(f"– {line}", markup=False)


def _warn(result: ScoreResult) -> None:
    for line in result.warnings:
        sys.stderr.write(f"{line}\n")


def show_profile(result: ScoreResult, path: Path | None, as_json: bool) -> None:
    """Print the scores of a profile, and write them where that is wanted."""
    _warn(result)
    rows, profile, sequences = result.rows, str(result.profile), result.sequences
    if path is not None:
        save_scores(path, rows)
        sys.stderr.write(f"{len(rows)} rows: {path}\n")
    if as_json:
        sys.stdout.write(json.dumps({"profile": profile, "scores": score_rows(rows)}, indent=1, allow_nan=False))
        sys.stdout.write("\n")
        return
    from fbench.metrics.profiles.remarks import lines

    out = console()
    out.print(f"{result.title}: profile {profile}", soft_wrap=True)
    out.print()
    table = lines(rows, profile)
    for group in _in_groups(table):
        out.print(_table(table, group))
        out.print()
    shown = [score for line in table for score in line.scores.values()]
    if len(sequences) > 1 and table:
        scores = _of_sequences(rows, table, sequences)
        out.print(_by_sequence(table, scores))
        out.print()
        shown += [score for cells in scores.values() for score in cells if score is not None]
    for line in (*_reasons(shown), *reasons_of_intervals(shown)):
        out.print(f"– {line}", soft_wrap=True)


def _in_groups(table: "Sequence[Line]") -> list[list[str]]:
    """Columns, as many at a time as a terminal has room for."""
    columns = list(dict.fromkeys(name for line in table for name in line.scores))
    return [columns[i : i + _MAX_COLUMNS] for i in range(0, len(columns), _MAX_COLUMNS)]


def _table(lines: "Sequence[Line]", columns: Sequence[str]) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("metric", no_wrap=True)
    for name in columns:
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("matched by")
    for line in lines:
        if any(name in line.scores for name in columns):
            cells = (_cell(line.scores.get(name)) for name in columns)
            table.add_row(line.metric, *cells, line.matching)
    return table


def _of_sequences(
    rows: Sequence[Score], lines: "Sequence[Line]", sequences: Sequence[str]
) -> dict[str, list[Score | None]]:
    """The first metrics of the first class, of each sequence."""
    from fbench.metrics.profiles.remarks import by_slice

    column, first = next(iter(lines[0].scores.items()))
    level, index = first.slice.removeprefix("all"), by_slice(rows)
    wholes = [line.scores[column] for line in _first_lines(lines)]
    return {
        name: [index.get((f"sequence {name}{level}", row.class_, row.metric, row.matching)) for row in wholes]
        for name in sequences
    }


def _first_lines(lines: "Sequence[Line]") -> "list[Line]":
    column = next(iter(lines[0].scores))
    return [line for line in lines if column in line.scores][:_COLUMNS_BY_SEQUENCE]


def _by_sequence(lines: "Sequence[Line]", scores: Mapping[str, Sequence[Score | None]]) -> Table:
    """A line a sequence."""
    table = Table(box=None, pad_edge=False)
    table.add_column(f"sequence ({next(iter(lines[0].scores))})")
    for line in _first_lines(lines):
        table.add_column(line.metric, justify="right", no_wrap=True)
    for name, cells in scores.items():
        table.add_row(name, *map(_cell, cells))
    return table


def _cell(score: Score | None) -> str:
    """Three decimals and the unit; counts as they are."""
    if score is None:
        return ""
    if score.value is None:
        return "–"
    is_count = score.metric in _counts() and score.counts.get(score.metric, score.value) == score.value
    if score.unit == "1" and is_count and score.value == int(score.value):
        return f"{score.value:.0f}{interval_text(score, 0)}"
    unit = "" if score.unit.lower() in ("1", "iou") else f" {score.unit}"
    return f"{score.value:.3f}{unit}{interval_text(score)}"


def _counts() -> frozenset[str]:
    from fbench.metrics.definitions.catalog import COUNTS

    return COUNTS


def _reasons(scores: Iterable[Score]) -> list[str]:
    """Why numbers are missing, each reason once."""
    found: dict[str, list[str]] = {}
    for score in scores:
        if score.reason is not None and score.metric not in found.setdefault(score.reason, []):
            found[score.reason].append(score.metric)
    return [f"{', '.join(metrics)}: {reason}" for reason, metrics in found.items()]
