"""Output of `fbench score`: the scores of a profile or of several runs, and what became of the boxes of a frame."""

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from fbench.api.scores import ScoreResult, open_folder
from fbench.cli import show
from fbench.cli.show import console, make_table, print_json, say
from fbench.replay.data.scores import Score, ScoreOptions, format_count, save_scores, score_rows

if TYPE_CHECKING:
    from fbench.metrics.explanation import Table as VerdictTable
    from fbench.metrics.profiles.remarks import Line

_MAX_COLUMNS = 6
_COLUMNS_BY_SEQUENCE = 8
_OUTCOMES = ("missed", "false alarm", "invalid", "hit", "ignored")


def show_together(result: ScoreResult, runs: Sequence[Path], out: Path | None, as_json: bool) -> None:
    """Print the scores of several runs together, and write them where that is wanted."""
    sys.stderr.writelines(f"{line}\n" for line in result.warnings)
    if out is not None:
        save_scores(out, result.rows)
    if as_json:
        print_json({"runs": [str(folder) for folder in runs], "scores": score_rows(result.rows)})
        return
    say(result.title)
    console().print(show.score_table(result.rows))
    say(*show.score_notes(result.rows))


def show_profile(result: ScoreResult, path: Path | None, as_json: bool) -> None:
    """Print the scores of a profile, and write them where that is wanted."""
    sys.stderr.writelines(f"{line}\n" for line in result.warnings)
    rows, profile, sequences = result.rows, str(result.profile), result.sequences
    if path is not None:
        save_scores(path, rows)
        sys.stderr.write(f"{format_count(len(rows), 'row')}: {path}\n")
    if as_json:
        print_json({"profile": profile, "scores": score_rows(rows)})
        return
    from fbench.metrics.profiles.remarks import by_slice, lines
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
        # A line a sequence with the first metrics of the first class.
        column, head = next(iter(table[0].scores.items()))
        level, index = head.slice.removeprefix("all"), by_slice(rows)
        heads = [line for line in table if column in line.scores][:_COLUMNS_BY_SEQUENCE]
        grid = make_table(f"sequence ({column})", *(line.metric for line in heads), right=[h.metric for h in heads])
        for metric in grid.columns[1:]:
            metric.no_wrap = True
        for name in sequences:
            wholes = (line.scores[column] for line in heads)
            cells = [index.get((f"sequence {name}{level}", s.class_, s.metric, s.matching)) for s in wholes]
            grid.add_row(name, *map(_cell, cells))
            shown += [score for score in cells if score is not None]
        out.print(grid)
        out.print()
    say(*(f"– {line}" for line in (*show.null_reasons(shown), *show.interval_reasons(shown))))


def _table(lines: "Sequence[Line]", columns: Sequence[str]) -> Table:
    table = make_table("metric", *columns, "matched by", right=columns)
    for column in table.columns[:-1]:
        column.no_wrap = True
    for line in lines:
        if any(name in line.scores for name in columns):
            cells = (_cell(line.scores.get(name)) for name in columns)
            table.add_row(line.metric, *cells, line.matching)
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
        return f"{score.value:.0f}{show.interval_text(score, 0)}"
    unit = "" if score.unit.lower() in ("1", "iou") else f" {score.unit}"
    return f"{score.value:.3f}{unit}{show.interval_text(score)}"


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


def show_controlled(runs: Sequence[Path], controls: Sequence[Path], as_json: bool) -> None:
    """Print numbers of all frames of runs, of which few are labeled, with intervals that other pipelines narrow."""
    from fbench.api.controls import estimate_by_controls

    found = estimate_by_controls(runs, controls)
    known = {name: one for name, one in found.items() if not isinstance(one, str)}
    if as_json:
        values = {name: {**asdict(one), "gain": one.gain} for name, one in known.items()}
        print_json({name: values.get(name, {"reason": one}) for name, one in found.items()})
        return
    table = make_table("metric", "labels alone", "95 %", "with controls", "95 %", "narrower by")
    for name, one in known.items():
        cells = [text for own in (one.plain, one.narrow) for text in (f"{own.value:.3f}", _ends(own.low, own.high))]
        table.add_row(name, *cells, f"{100 * one.gain:.0f} %" if one.gain > 0 else "no gain; take labels alone")
    console().print(table)
    say(*(f"{name}: {why}" for name, why in found.items() if isinstance(why, str)))
    for one in list(known.values())[:1]:
        say(f"{one.num_labeled} of {one.num_frames} frames are labeled; intervals hold if they were drawn at random")


def _ends(low: float, high: float) -> str:
    return f"{low:.3f} to {high:.3f}"
