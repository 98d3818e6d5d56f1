"""Output of `fbench score`: the scores of a profile or of several runs, and what became of the boxes of a frame."""

import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from fbench.api.scores import ScoreResult, open_folder
from fbench.cli.show import (
    console,
    interval_reasons,
    interval_text,
    make_table,
    null_reasons,
    print_json,
    say,
    score_notes,
    score_table,
)
from fbench.replay.data.scores import Score, ScoreOptions, save_scores, score_rows

if TYPE_CHECKING:
    from fbench.metrics.explanation import Table as VerdictTable
    from fbench.metrics.profiles.remarks import Line

_MAX_COLUMNS = 6
_COLUMNS_BY_SEQUENCE = 8
_OUTCOMES = ("missed", "false alarm", "invalid", "hit", "ignored")


def show_together(result: ScoreResult, runs: Sequence[Path], out: Path | None, as_json: bool) -> None:
    """Print the scores of several runs together, and write them where that is wanted."""
    _warn(result)
    if out is not None:
        save_scores(out, result.rows)
    if as_json:
        print_json({"runs": [str(folder) for folder in runs], "scores": score_rows(result.rows)})
        return
    say(result.title)
    console().print(score_table(result.rows))
    say(*score_notes(result.rows))


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
    from fbench.replay.contracts.profiles import Headlines

    out = console()
    say(f"{result.title}: profile {profile}", "")
    table = lines(rows, result.headlines or Headlines())
    columns = list(dict.fromkeys(name for line in table for name in line.scores))
    for first in range(0, len(columns), _MAX_COLUMNS):
        out.print(_table(table, columns[first : first + _MAX_COLUMNS]))
        out.print()
    shown = [score for line in table for score in line.scores.values()]
    if len(sequences) > 1 and table:
        scores = _of_sequences(rows, table, sequences)
        out.print(_by_sequence(table, scores))
        out.print()
        shown += [score for cells in scores.values() for score in cells if score is not None]
    say(*(f"– {line}" for line in (*null_reasons(shown), *interval_reasons(shown))))


def _table(lines: "Sequence[Line]", columns: Sequence[str]) -> Table:
    table = make_table("metric", *columns, "matched by", right=columns)
    for column in table.columns[:-1]:
        column.no_wrap = True
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
    table = make_table(f"sequence ({next(iter(lines[0].scores))})")
    for line in _first_lines(lines):
        table.add_column(line.metric, justify="right", no_wrap=True)
    for name, cells in scores.items():
        table.add_row(name, *map(_cell, cells))
    return table


def _cell(score: Score | None) -> str:
    """Three decimals and the unit; counts as they are."""
    from fbench.metrics.definitions.catalog import COUNTS

    if score is None:
        return ""
    if score.value is None:
        return "–"
    is_count = score.metric in COUNTS and score.counts.get(score.metric, score.value) == score.value
    if score.unit == "1" and is_count and score.value == int(score.value):
        return f"{score.value:.0f}{interval_text(score, 0)}"
    unit = "" if score.unit.lower() in ("1", "iou") else f" {score.unit}"
    return f"{score.value:.3f}{unit}{interval_text(score)}"


def explain_run(run: Path, options: ScoreOptions, frame: int, class_: str, as_json: bool) -> None:
    """Print what became of each box of a frame. Raises FbenchError where there is no such run, frame or class, or the
    frame isn't scored.
    """
    from fbench.metrics.explanation import explain_frame

    explanation = explain_frame(open_folder(run), options, frame, class_)
    if as_json:
        print_json(explanation.content())
        return
    say(f"frame {explanation.frame} at {explanation.stamp_ns} ns, {explanation.class_}, {explanation.matching}")
    if explanation.num_invalid_truth:
        say(f"{explanation.num_invalid_truth} truth boxes aren't finite and were left out")
    for table in explanation.tables:
        say("")
        console().print(_verdict_table(table))
        left_out = Counter(row.reason.partition(":")[0] for row in table.truth if row.outcome == "ignored")
        if left_out:
            why = ", ".join(f"{num} {reason}" for reason, num in sorted(left_out.items()))
            say(f"truth that needn't be found: {why} (each of them with --json)")


def _verdict_table(found: "VerdictTable") -> Table:
    """What went wrong first."""
    rows = sorted((row for row in (*found.truth, *found.estimates) if row.side != "truth" or row.outcome != "ignored"),
                  key=lambda row: _OUTCOMES.index(row.outcome))  # fmt: skip
    has_camera = any(row.camera for row in rows)
    columns = ("box", *(["camera"] if has_camera else []), "class", "id", "score", "range", "outcome", "why")
    table = make_table(*columns, right=("id", "score", "range"))
    table.title, table.title_justify = f"{found.judged}s", "left"
    for row in rows:
        table.add_row(
            f"{row.side} {row.number}", *([row.camera] if has_camera else []), row.class_ or "–",
            "–" if row.track_id is None else str(row.track_id), "–" if row.score is None else f"{row.score:.2f}",
            "–" if row.range_m is None else f"{row.range_m:.1f} m", row.outcome, row.reason,
        )  # fmt: skip
    return table
