"""The matrix of a robustness suite: scores of pipelines by condition and severity, with intervals, and its tables."""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fbench.metrics.core.bootstrap import LEAST_UNITS, Bootstrap
from fbench.metrics.robustness import aggregates
from fbench.metrics.robustness.scenes import ScoredRun, Space, pool, spaces_of
from fbench.metrics.runs.places import SharedRun
from fbench.metrics.runs.scoring import cut_run, measure_pieces
from fbench.replay.data.arrays import Array, Float64, Int64
from fbench.replay.data.scores import Column, Curves, Figure, Line, ResultTable, ScoreOptions
from fbench.replay.runs.folder import Run

CLEAR = "clear"
_COUNTS = ("tp", "fp", "fn", "track_tp", "track_fp", "track_fn", "idsw")


@dataclass(frozen=True)
class Cell:
    """One run of a suite."""

    pipeline: str
    condition: str
    """Without its severity; `clear` for none."""
    severity: str
    """`1` to `5`; empty where the condition says itself how strong it is."""
    log: str
    run: Run | None
    reason: str = ""
    """Why there is no run."""


def count_pieces(run: Run, options: ScoreOptions) -> dict[str, tuple[int, ...]]:
    """Return hits, false alarms and misses of detections and tracks and switches of identity in each piece of a run, by
    its number; of the whole run where it can't be cut. Raises MetricError where an id occurs twice in one frame.
    """
    shared = SharedRun(run.folder)
    cut = cut_run(shared, LEAST_UNITS)
    if isinstance(cut, str):
        cut = cut_run(shared, 1)
    if isinstance(cut, str):
        return {}
    counts: dict[str, tuple[int, ...]] = {}
    for number, table in measure_pieces(shared, cut, options).items():
        boxes, clear = table.detection[0].counts.boxes, table.tracking[0].counts.clear
        counts[number] = (boxes.tp, boxes.fp, boxes.fn, clear.tp, clear.fp, clear.fn, clear.switches)
    return counts


def _f1(counts: Array) -> Float64:
    """F1 of counts (..., 7)."""
    tp, fp, fn = counts[..., 0], counts[..., 1], counts[..., 2]
    return _ratio(2 * tp, 2 * tp + fp + fn)


def _mota(counts: Array) -> Float64:
    """MOTA of counts (..., 7)."""
    tp, fp, fn, switches = (counts[..., at] for at in range(3, 7))
    return _ratio(tp - fp - switches, tp + fn)


def _ratio(top: Array, bottom: Array) -> Float64:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(bottom != 0, top / bottom, np.nan), np.float64)


@dataclass(frozen=True, eq=False)
class Matrix:
    """Cells of pipelines x conditions x severities x logs."""

    cells: Sequence[Cell]
    options: ScoreOptions
    how: Bootstrap

    @cached_property
    def pipelines(self) -> list[str]:
        """In the order in which they first come."""
        return list(dict.fromkeys(cell.pipeline for cell in self.cells))

    @cached_property
    def conditions(self) -> list[tuple[str, list[str]]]:
        """Conditions but clear, with their severities."""
        found: dict[str, dict[str, None]] = {}
        for cell in self.cells:
            if cell.condition != CLEAR:
                found.setdefault(cell.condition, {})[cell.severity] = None
        return [(name, sorted(own)) for name, own in found.items()]

    def space(self, pipeline: str) -> Space:
        """In which a pipeline's own boxes are."""
        spaces = spaces_of(_scored_runs(cell for cell in self.cells if cell.pipeline == pipeline))
        return spaces[-1] if spaces else "3D"

    def logs(self, condition: str, severity: str) -> set[str]:
        """Return the logs that a condition fits, whatever became of their cells."""
        return {cell.log for cell in self.cells if (cell.condition, cell.severity) == (condition, severity)}

    def pool_cell(
        self, pipeline: str, condition: str, severity: str, metric: str, logs: Collection[str] | None = None
    ) -> Figure:
        """Return a metric of a cell over all its logs, or over some of them; none where one of them has no run."""
        key = (pipeline, condition, severity)
        own = [
            c for c in self.cells if (c.pipeline, c.condition, c.severity) == key and (logs is None or c.log in logs)
        ]
        for cell in own:
            if cell.run is None:
                return Figure(None, f"failed on {cell.log}: {cell.reason}")
        return pool(_scored_runs(own), metric, self.space(pipeline)) if own else Figure(None, "no run")

    @cached_property
    def _pieces(self) -> dict[tuple[str, str, str], dict[tuple[str, str], tuple[int, ...]]]:
        """Counts of each piece, by pipeline, condition and severity, then by log and number."""
        found: dict[tuple[str, str, str], dict[tuple[str, str], tuple[int, ...]]] = {}
        for cell in self.cells:
            if cell.run is not None:
                own = found.setdefault((cell.pipeline, cell.condition, cell.severity), {})
                own |= {(cell.log, number): c for number, c in count_pieces(cell.run, self.options).items()}
        return found

    @cached_property
    def _units(self) -> list[tuple[str, str]]:
        """Pieces that all runs of a log have: they are cut at the same instants, whatever the condition."""
        found: dict[str, set[tuple[str, str]]] = {}
        for own in self._pieces.values():
            for log in {log for log, _ in own}:
                units = {unit for unit in own if unit[0] == log}
                found[log] = found.get(log, units) & units
        return sorted(unit for units in found.values() for unit in units)

    @cached_property
    def _times(self) -> Int64:
        return self.how.times(len(self._units))

    def resample(
        self, pipeline: str, condition: str, severity: str, logs: Collection[str] | None = None
    ) -> Int64 | None:
        """Return the counts (num, 7) of each resample of the pieces, of some logs if they are named; `None` where there
        are too few.
        """
        own = self._pieces.get((pipeline, condition, severity), {})
        known = {unit for unit in self._units if unit in own and (logs is None or unit[0] in logs)}
        if len(known) < LEAST_UNITS:
            return None
        nothing = (0,) * len(_COUNTS)
        counts = [own[unit] if unit in known else nothing for unit in self._units]
        return np.asarray(self._times @ np.array(counts, np.int64))

    def difference(self, base: str, head: str, condition: str, severity: str = "") -> tuple[float | None, float | None]:
        """Return the ends of the interval of a pipeline's F1 minus that of a base, on the same stretches."""
        pair = [self.resample(name, condition, severity) for name in (base, head)]
        if pair[0] is None or pair[1] is None:
            return None, None
        return self.interval(0.0, _f1(pair[1]) - _f1(pair[0]))

    @property
    def note(self) -> str:
        """How intervals were made."""
        if len(self._units) < LEAST_UNITS:
            return f"No intervals: {len(self._units)} stretches of at least 1 s with truth, {LEAST_UNITS} are needed."
        share = f"{100 * self.how.share:g} %"
        return (
            f"In brackets: {share} of {self.how.num} bootstrap resamples of {len(self._units)} stretches, "
            "the same ones in clear weather and under the condition."
        )

    def interval(self, value: float | None, resamples: Array | None) -> tuple[float | None, float | None]:
        """Return the ends of the interval of a value from its resamples (num,)."""
        return (None, None) if value is None else self.how.interval(resamples)


def _scored_runs(cells: Iterable[Cell]) -> list[ScoredRun]:
    return [
        ScoredRun(cell.pipeline, f"{cell.condition}:{cell.severity}", cell.log, cell.run.scores)
        for cell in cells if cell.run is not None
    ]  # fmt: skip


def matrix_tables(matrix: Matrix, baseline: str | None = None) -> tuple[ResultTable, ...]:
    """Return the tables: change of F1 by condition, aggregates, then F1, its change and MOTA's by severity. Aggregates
    that need a baseline pipeline are without value where there is none.
    """
    return (
        _change_by_condition(matrix),
        _aggregates(matrix, baseline),
        _by_severity(matrix, "robustness_f1", "F1 by condition and severity, %", "f1", is_change=False),
        _by_severity(matrix, "robustness_f1_change", "Change of F1 against clear, %", "f1", is_change=True),
        _by_severity(matrix, "robustness_mota_change", "Change of MOTA against clear, %", "mota", is_change=True),
    )


def _change_by_condition(matrix: Matrix) -> ResultTable:
    """The thesis's table 9.5: one number a condition, the mean over severities."""
    columns, lines = (Column("clear F1"), *(Column(name, "change") for name, _ in matrix.conditions)), []
    for pipeline in matrix.pipelines:
        clear = matrix.pool_cell(pipeline, CLEAR, "", "f1")
        low, high = matrix.interval(clear.value, _resample(matrix, pipeline, CLEAR, "", _f1))
        figures = [Figure(clear.value, clear.reason, clear.counts, None, low, high)]
        for name, severities in matrix.conditions:
            changes = [_change(matrix, pipeline, name, severity, "f1") for severity in severities]
            figures.append(_mean(matrix, changes))
        lines.append(Line(pipeline, matrix.space(pipeline), tuple(figures)))
    notes = ("Relative, mean over severities: -50 is half of the F1 in clear weather.", matrix.note)
    return ResultTable("robustness", "Change of F1 against clear (table 9.5), %", columns, tuple(lines), notes)


@dataclass(frozen=True, eq=False)
class _Change:
    """A relative change with its resamples."""

    figure: Figure
    resamples: Array | None


def _change(matrix: Matrix, pipeline: str, condition: str, severity: str, metric: str) -> _Change:
    logs = matrix.logs(condition, severity)  # A condition may not fit all
    clear, then = (matrix.pool_cell(pipeline, *key, metric, logs) for key in ((CLEAR, ""), (condition, severity)))
    counts = {f"{when}_{name}": num for when, f in (("clear", clear), ("then", then)) for name, num in f.counts.items()}
    for when, figure in (("clear weather", clear), (condition, then)):
        if figure.value is None:
            return _Change(Figure(None, f"none in {when}: {figure.reason}", counts), None)
    if not clear.value or then.value is None:
        return _Change(Figure(None, "0 in clear weather", counts), None)
    if clear.value < 0:
        return _Change(Figure(None, "below 0 in clear weather", counts), None)
    value, of = (then.value - clear.value) / clear.value, _f1 if metric == "f1" else _mota
    base, other = (_resample(matrix, pipeline, *key, of, logs) for key in ((CLEAR, ""), (condition, severity)))
    resamples = None if base is None or other is None else _ratio(other - base, base)
    low, high = matrix.interval(value, resamples)
    return _Change(Figure(value, None, counts, None, low, high), resamples)


def _mean(matrix: Matrix, changes: Sequence[_Change]) -> Figure:
    values = [change.figure.value for change in changes]
    if None in values:
        return next(change.figure for change in changes if change.figure.value is None)
    value = float(np.mean([v for v in values if v is not None]))
    samples = [change.resamples for change in changes if change.resamples is not None]
    low, high = matrix.interval(value, np.mean(samples, axis=0) if len(samples) == len(changes) else None)
    return Figure(value, None, {}, None, low, high)


def _resample(
    matrix: Matrix, pipeline: str, condition: str, severity: str, of: Callable[[Array], Float64],
    logs: Collection[str] | None = None,
) -> Float64 | None:  # fmt: skip
    counts = matrix.resample(pipeline, condition, severity, logs)
    return None if counts is None else of(counts)


def _by_severity(matrix: Matrix, name: str, title: str, metric: str, *, is_change: bool) -> ResultTable:
    columns = tuple(Column(pipeline, "change" if is_change else "share") for pipeline in matrix.pipelines)
    lines = [] if is_change else [_line(matrix, CLEAR, "", metric)]
    for condition, severities in matrix.conditions:
        for severity in severities:
            if is_change:
                figures = tuple(_change(matrix, p, condition, severity, metric).figure for p in matrix.pipelines)
                lines.append(Line(_title(condition, severity), "", figures))
            else:
                lines.append(_line(matrix, condition, severity, metric))
    return ResultTable(name, title, columns, tuple(lines), (matrix.note,))


def _line(matrix: Matrix, condition: str, severity: str, metric: str) -> Line:
    figures = tuple(_figure(matrix, pipeline, condition, severity, metric) for pipeline in matrix.pipelines)
    return Line(_title(condition, severity), "", figures)


def _figure(
    matrix: Matrix, pipeline: str, condition: str, severity: str, metric: str, logs: Collection[str] | None = None
) -> Figure:
    """A metric of a cell with its interval."""
    figure = matrix.pool_cell(pipeline, condition, severity, metric, logs)
    of = _f1 if metric == "f1" else _mota
    low, high = matrix.interval(figure.value, _resample(matrix, pipeline, condition, severity, of, logs))
    return Figure(figure.value, figure.reason, figure.counts, None, low, high)


def severity_curves(matrix: Matrix) -> tuple[Curves, ...]:
    """Return how F1 goes from clear weather over the severities of each condition that has several."""
    found = []
    for condition, severities in matrix.conditions:
        if len(severities) > 1:
            logs = matrix.logs(condition, severities[0])
            keys = [(CLEAR, ""), *((condition, severity) for severity in severities)]
            lines = [
                Line(name, matrix.space(name), tuple(_figure(matrix, name, *key, "f1", logs) for key in keys))
                for name in matrix.pipelines
            ]
            found.append(Curves(condition, (CLEAR, *severities), tuple(lines)))
    return tuple(found)


def _title(condition: str, severity: str) -> str:
    return f"{condition} {severity}".strip()


def _aggregates(matrix: Matrix, baseline: str | None) -> ResultTable:
    """Means over the conditions that have the same severities for all, and fit all logs."""
    usual, logs = _usual(severities for _, severities in matrix.conditions), matrix.logs(CLEAR, "")
    names = [
        name for name, severities in matrix.conditions
        if severities == usual and all(matrix.logs(name, severity) == logs for severity in severities)
    ]  # fmt: skip
    columns = (Column("mPC"), Column("mRR"), Column("mCE"), Column("relative mCE"), Column("mRRA", "change"))
    lines = []
    for pipeline in matrix.pipelines:
        values = _aggregate(matrix, pipeline, baseline, names, usual, resampled=False)
        samples = _aggregate(matrix, pipeline, baseline, names, usual, resampled=True)
        figures = []
        for column, value in values.items():
            if isinstance(value, str):
                figures.append(Figure(None, value))
                continue
            number = float(value)
            if not np.isfinite(number):
                figures.append(
                    Figure(None, "the baseline doesn't drop" if "relative" in column else "nothing to divide by")
                )
                continue
            own = samples[column]
            figures.append(
                Figure(number, None, {}, None, *matrix.interval(number, None if isinstance(own, str) else own))
            )
        lines.append(Line(pipeline, matrix.space(pipeline), tuple(figures)))
    told = f"the baseline {baseline}" if baseline else "a baseline"
    note = (
        f"Of F1 over {', '.join(names) or 'no condition'}, severities {', '.join(usual) or 'as given'}; "
        f"mPC: mean F1; mRR: share of the clear F1 that is left, which MultiCorrupt calls mRA; mCE, relative mCE and "
        f"mRRA: against {told}, where 100 % and 0 are as good as it; lower is better for mCE."
    )
    notes = (note, matrix.note)
    return ResultTable("robustness_aggregates", "Robustness over all conditions, %", columns, tuple(lines), notes)


def _usual(severities: Iterable[list[str]]) -> list[str]:
    """The severities that most conditions have; the first of equally many."""
    counts = Counter(tuple(own) for own in severities)
    return [*max(counts, key=lambda key: counts[key], default=())]


def _aggregate(
    matrix: Matrix, pipeline: str, baseline: str | None, names: Sequence[str], severities: Sequence[str], *,
    resampled: bool,
) -> Mapping[str, Array | str]:  # fmt: skip
    """Aggregates of a pipeline, or of each of its resamples; a text says why there is none."""

    def scores(name: str) -> tuple[Array, Array] | None:
        """F1 (..., C, S) and in clear weather (...)."""
        if resampled:
            whole = _resample(matrix, name, CLEAR, "", _f1)
            parts = [[_resample(matrix, name, c, s, _f1) for s in severities] for c in names]
            if whole is None or any(part is None for row in parts for part in row):
                return None
            return np.array(parts).transpose(2, 0, 1), whole
        values = [[matrix.pool_cell(name, c, s, "f1").value for s in severities] for c in names]
        clear = matrix.pool_cell(name, CLEAR, "", "f1").value
        if clear is None or any(value is None for row in values for value in row):
            return None
        return np.array(values, np.float64), np.asarray(clear)

    own = scores(pipeline) if names else None
    if own is None:
        return dict.fromkeys(("mPC", "mRR", "mCE", "relative mCE", "mRRA"), "a cell has no F1")
    score, clear = own
    found: dict[str, Array | str] = {
        "mPC": score.mean((-2, -1)), "mRR": aggregates.resilience_rate(score, clear).mean(-1),
    }  # fmt: skip
    base = scores(baseline) if baseline else None
    if base is None:
        why = "a cell of the baseline has no F1" if baseline else "no baseline"
        return {**found, **dict.fromkeys(("mCE", "relative mCE", "mRRA"), why)}
    return {
        **found,
        "mCE": aggregates.corruption_error(score, base[0]).mean(-1),
        "relative mCE": aggregates.relative_corruption_error(score, clear, *base).mean(-1),
        "mRRA": aggregates.relative_resistance(score, base[0]).mean(-1),
    }
